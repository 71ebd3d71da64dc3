"""How well becalm estimates readings of real recordings that were hidden in blocks.

Of every channel of every recording (its first 20 000 rows; recordings of less than 1000 rows and channels with less
than ten values are left out), blocks of 8, 40 or 200 readings, 5 % of all rows, are hidden at random places, and the
record is smoothed without options. *ratio* is the rms error at the hidden readings relative to the better of two
rivals: a line across each block, and the best Butterworth filter forward and back over readings whose holes are filled
with lines; its order (1, 2 or 4) and its cut-off are chosen *with the hidden readings*. Errors below the rounding of
the converter count as that rounding. Bounds: never above 1.3; median at most 1.0. Rows in which the estimate is NaN are
counted, and left out for both; *filled* is the ratio over all hidden readings with `--fill`. The last table has the
number of readings that each record loses when no reading is hidden.

Run: python benchmarks/hidden_blocks.py [-o docs/hidden-blocks.md] [--jobs N] [--quick] [NAME ...]
The recordings are in ../shared/data; with names, only files whose path contains one of them are processed.
`--quick` uses the first 5000 rows. Needs `pip install 'becalm[formats]'`.
"""

from __future__ import annotations

import sys
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import becalm
from becalm.classic.bridging import interpolate_linearly
from becalm.classic.register import CLASSICS
from becalm.core.reading_verdicts import LOST, Verdict
from pages import page_parser, publish

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
from real_recordings import DATA, files, parts

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

LENGTHS = (8, 40, 200)
WORST = 1.3
_SHARE = 0.05
_LONGEST, _QUICK, _SHORTEST = 20_000, 5000, 1000
_FEWEST_VALUES = 10
_FEW = 0.1  # with estimates for a smaller share of the hidden readings, no ratio is computed
_CUTOFFS = np.geomspace(2e-4, 0.49, 40)
_SEED = 20261103


class Block(NamedTuple):
    """The result for one channel with blocks of one length.

    Attributes
    ----------
    recording, channel : str
        Names of the recording and the channel.
    length : int
        Number of readings in a block.
    ratio : float
        Error of becalm relative to that of the better rival; NaN with few estimates or after an exception.
    error : float
        The rms error of becalm with `--fill`, in the channel's unit.
    filled : float
        The ratio over all hidden readings, with the estimates of `--fill`.
    rival : str
        Name of the better rival.
    unknown : float
        Share of the hidden readings for which the estimate is NaN.
    verdict : str
        Verdict of becalm on its model, or the exception.
    """

    recording: str
    channel: str
    length: int
    ratio: float
    error: float
    filled: float
    rival: str
    unknown: float
    verdict: str


class LeftOut(NamedTuple):
    """The number of readings of a channel that its filter did not use.

    Attributes
    ----------
    recording, channel : str
        Names of the recording and the channel.
    readings : int
        Number of all readings.
    counts : dict of str to int
        Number of unused readings, by verdict.
    """

    recording: str
    channel: str
    readings: int
    counts: dict[str, int]


class Channel(NamedTuple):
    """A channel of a recording; `data` has only this channel."""

    recording: str
    data: becalm.Recording


def channels(names: Sequence[str], longest: int) -> Iterator[Channel]:
    """Yield the first rows of all channels of all recordings."""
    for path in files():
        if names and not any(name in str(path) for name in names):
            continue
        for part in parts(path):
            if part.recording is None or len(part.recording) < _SHORTEST:
                continue
            title = f"{path.relative_to(DATA)}{': ' if part.title else ''}{part.title}"
            times = part.recording.times_s[:longest]
            for name, z in zip(part.recording.names, part.recording.samples[:longest].T, strict=True):
                if len(np.unique(z[np.isfinite(z)])) >= _FEWEST_VALUES:
                    yield Channel(title, becalm.Recording(z.copy(), names=[name], times_s=times))


def hidden_rows(z: Floats, length: int, rng: np.random.Generator) -> Flags:
    """Return the rows (N,) to hide: 5 % of all in blocks, but no row at an end, and none that is missing already."""
    known, hidden = np.flatnonzero(np.isfinite(z)), np.zeros(len(z), bool)
    count = max(round(_SHARE * len(known) / length), 1)
    part = len(known) // count
    for k in range(count):
        start = k * part + 1 + int(rng.integers(max(part - length - 2, 1)))
        hidden[known[start : min(start + length, len(known) - 1)]] = True
    return hidden


def rivals(z: Floats, hidden: Flags) -> dict[str, Floats]:
    """Return the errors of a line and of each Butterworth filter at the hidden readings of z (N,)."""
    filled = interpolate_linearly(np.where(hidden, np.nan, z))
    off = {"line": (filled - z)[hidden]}
    for order in (1, 2, 4):
        one = CLASSICS[f"Butterworth {order} both ways"]
        for cutoff in _CUTOFFS:
            off[f"{one.name}, {cutoff:.2g}"] = (one.apply(filled, float(cutoff)) - z)[hidden]
    return off


def best_of(off: dict[str, Floats], rows: Flags) -> tuple[float, str]:
    """Return the least rms error in some of the hidden rows, and the name of the rival that has it."""
    errors = {name: _rms(one, rows) for name, one in off.items()}
    best = min(errors, key=lambda name: errors[name])
    return errors[best], best


def _rms(off: Floats, rows: Flags) -> float:
    return float(np.sqrt(np.mean(off[rows] ** 2)))


def block(channel: Channel, length: int) -> Block:
    """Hide blocks of one length in a channel, clean it, and compare."""
    z, name = channel.data.samples[:, 0], channel.data.names[0]
    mark = [zlib.crc32(text.encode()) for text in (channel.recording, name)]
    hidden = hidden_rows(z, length, np.random.default_rng([_SEED, length, *mark]))
    seen, off = channel.data.with_samples(np.where(hidden, np.nan, z)[:, np.newaxis]), rivals(z, hidden)
    try:
        recipe = becalm.tune(seen)
        out = becalm.clean(seen, recipe)
        filling = recipe.model_copy(update={"channel": (recipe.channel[0].model_copy(update={"fill": True}),)})
        filled = becalm.clean(seen, filling).signal.samples[:, 0]
    except Exception as failure:
        says = f"{type(failure).__name__}: {failure}".replace("\n", " ")[:120]
        return Block(channel.recording, name, length, np.nan, np.nan, np.nan, "", 1.0, says)
    error, report = (out.signal.samples[:, 0] - z)[hidden], out.reports[0]
    known, all_rows = np.isfinite(error), np.ones(np.count_nonzero(hidden), bool)
    rounding = float(np.diff(np.unique(z[np.isfinite(z)])).min()) / np.sqrt(12)
    least, rival = best_of(off, known) if known.mean() > _FEW else (np.nan, "")
    ratio = _rms(error, known) / max(least, rounding) if known.mean() > _FEW else np.nan
    least_of_all, best = best_of(off, all_rows)
    ratio_filled = _rms((filled - z)[hidden], all_rows) / max(least_of_all, rounding)
    verdict = f"{report.verdict}, order {report.order}" if report.order else report.verdict
    return Block(
        channel.recording, name, length, ratio, _rms((filled - z)[hidden], all_rows), ratio_filled, rival or best,
        1 - np.count_nonzero(known) / len(known), verdict,
    )  # fmt: skip


def left_out(channel: Channel) -> LeftOut:
    """Clean a channel without hidden readings, and count the readings that the filter does not use."""
    recipe = becalm.tune(channel.data, wishes=becalm.Wishes(fill=True))  # else HOLE would hide why readings were lost
    counts = becalm.clean(channel.data, recipe).reports[0].verdicts
    lost = {Verdict(code).name.lower() for code in np.flatnonzero(LOST).tolist()} - {"missing"}
    readings = int(np.isfinite(channel.data.samples).sum())
    found = {verdict: count for verdict, count in counts.items() if verdict in lost and count}
    return LeftOut(channel.recording, channel.data.names[0], readings, found)


def blocks(channel: Channel) -> tuple[list[Block], LeftOut]:
    """Hide blocks of each length that fits into the record; also count the readings that it loses without them."""
    found = [block(channel, length) for length in LENGTHS if _SHARE * len(channel.data) >= length]
    return found, left_out(channel)


def page(found: Sequence[Block], lost: Sequence[LeftOut]) -> str:
    """Return the whole page."""
    above = f"above {WORST}"
    head = f"channels | median ratio | {above} | worst | median filled | {above} | worst filled | failed | NaN |"
    lines = ["## Bounds", "", f"| block | {head}", "|---" * 10 + "|"]
    for length in LENGTHS:
        lines.append(f"| {length} | {_summary([one for one in found if one.length == length])} |")
    lines += [
        f"| all | {_summary(found)} |",
        "",
        "## Recordings",
        "",
        f"| recording | block | {head}",
        "|---" * 11 + "|",
    ]
    for recording in dict.fromkeys(one.recording for one in found):
        for length in LENGTHS:
            if of := [one for one in found if one.recording == recording and one.length == length]:
                lines.append(f"| {_cell(recording)} | {length} | {_summary(of)} |")
    beyond = sorted((one for one in found if _worst(one) > WORST), key=lambda one: -_worst(one))
    lines += ["", f"## Above {WORST}", "", "| recording | channel | block | ratio | filled | NaN | the better rival |"]
    lines[-1] += " verdict |"
    lines.append("|---" * 8 + "|")
    lines += [
        f"| {_cell(one.recording)} | {_cell(one.channel)} | {one.length} | {one.ratio:.3g} | {one.filled:.3g}"
        f" | {one.unknown:.0%} | {one.rival} | {_cell(one.verdict)} |"
        for one in beyond
    ]
    failed = [one for one in found if not np.isfinite(one.filled)]
    lines += ["", *(f"- failed: {one.recording}, {one.channel}, {one.length}: {one.verdict}" for one in failed)]
    lines += ["", "## Left out", "", "| recording | channels | readings | left out | of one channel at most | |"]
    lines.append("|---" * 6 + "|")
    for recording in dict.fromkeys(one.recording for one in lost):
        lines.append(f"| {_cell(recording)} | {_lost([one for one in lost if one.recording == recording])} |")
    return "\n".join(lines) + "\n"


def _worst(one: Block) -> float:
    """Return the larger of both ratios."""
    return float(np.nanmax([one.ratio, one.filled, 0.0]))


def _summary(of: Sequence[Block]) -> str:
    """Return the cells of some channels: their number; of both ratios the median, violations, worst; failures, NaN."""
    cells = [str(len(of))]
    for values in ([one.ratio for one in of], [one.filled for one in of]):
        ratios = np.array([value for value in values if np.isfinite(value)])
        cells += [""] * 3
        if len(ratios):
            cells[-3:] = f"{np.median(ratios):.3f}", str(np.count_nonzero(ratios > WORST)), f"{ratios.max():.3g}"
    failed, unknown = sum(not np.isfinite(one.filled) for one in of), float(np.mean([one.unknown for one in of]))
    return " | ".join([*cells, str(failed), f"{unknown:.1%}"])


def _lost(of: Sequence[LeftOut]) -> str:
    """Return the cells of a recording's channels: their number, their readings, and the readings that they lose."""
    readings, total = sum(one.readings for one in of), Counter[str]()
    for one in of:
        total.update(one.counts)
    most = max(of, key=lambda one: sum(one.counts.values()) / max(one.readings, 1))
    share = sum(most.counts.values()) / max(most.readings, 1)
    words = ", ".join(f"{count} {verdict}" for verdict, count in total.most_common())
    at_most = f"{share:.2%} {_cell(most.channel)}" if share else ""
    return f"{len(of)} | {readings} | {sum(total.values()) / max(readings, 1):.3%} | {at_most} | {words}"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def main() -> None:
    """Print the tables; with -o, write them as a page."""
    parser = page_parser(__doc__)
    parser.add_argument("names", nargs="*", help="files whose path holds one of these")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--quick", action="store_true", help="only the first 5000 rows")
    arguments = parser.parse_args()
    todo = channels(arguments.names, _QUICK if arguments.quick else _LONGEST)
    found: list[Block] = []
    lost: list[LeftOut] = []
    with get_context("spawn").Pool(arguments.jobs) as pool:
        for results, counts in pool.imap(blocks, todo):
            found += results
            lost.append(counts)
            for one in results:
                what = f"{one.recording}, {one.channel}, {one.length}"
                print(f"{what}: {one.ratio:.3f} filled {one.filled:.3f}", file=sys.stderr)
    publish("Readings hidden in blocks", __doc__, page(found, lost), arguments.output)


if __name__ == "__main__":
    main()
