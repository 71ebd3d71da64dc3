"""Exported C compared with becalm itself: on real recordings, and on ten million readings.

Every channel of every recording is tuned as a causal filter (on its first 20 000 rows), exported as float64, float32
and q31 with the range of its readings, compiled by `cc -O2`, and run over the whole record, row by row, as is
becalm's own stream; readings that are passed through while a filter starts are not compared. *float64* is the largest
difference, relative to the largest signal; *float32* and *q31* are the ratio of the powers of signal and difference.
Where a filter with a constant gain meets missing readings, or where a filter that starts uses a thinned table of gains,
it is compared with its own specification in Python, which equals becalm's stream elsewhere. If a channel is less exact
than required, the page shows the row, the change of becalm's own stream when readings change in their last digit (no
program can be closer than that), and the difference between C and its specification, which has more digits where the
stream rounds them away. The readings hardly determine the first signal of a filter with several tones: there becalm
and C both have eleven digits (`tests/export/test_first_rows.py`). Channels that are not exported are counted by reason.

Run: python benchmarks/export_records.py [-o docs/export-records.md] [NAME ...]; needs `pip install 'becalm[formats]'`.
The recordings are in ../shared/data; with names, only files whose path contains one of them are processed.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import becalm
from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.core.arrays import Floats
from becalm.errors import BecalmError
from becalm.export.bundle import ExportOptions, bundle_of
from becalm.export.number_type import Precision
from becalm.export.proof.compiling import build
from becalm.export.proof.verifying import RecordComparison, compare, run_specification, write_bundle
from pages import page_parser, publish

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
from real_recordings import DATA, files, parts

_TUNED_ON = 20_000
_LONG = 10_000_000
_SAME = 1e-12
_FIRST = 20_000  # rows that are compared with a specification
_PRECISIONS: tuple[Precision, ...] = ("float64", "float32", "q31")


class Row(NamedTuple):
    """The results for one record."""

    record: str
    channels: int
    rows: int
    found: dict[Precision, list[Addition]]
    refused: Counter[str]


def tuned(recording: becalm.Recording) -> list[ChannelRecipe]:
    """Tune every channel of a recording."""
    first = slice(0, _TUNED_ON)
    part = becalm.Recording(
        recording.samples[first], names=recording.names, units=recording.units, times_s=recording.times_s[first]
    )
    return list(becalm.tune(part, causal=True).channel)


class Addition(NamedTuple):
    """The comparison of C with becalm on one channel, with the sensitivity of becalm itself."""

    compared: RecordComparison
    moved: float
    """Change of becalm's stream, relative to the largest signal, when readings change in their last digit."""

    specified: RecordComparison | None
    """Comparison of the first rows with the specification, if C is not exact enough and the channel has no modes."""


def compared(channel: ChannelRecipe, rate_hz: float, readings: Floats, precision: Precision) -> Addition:
    """Export one channel, compile it, and run a record through it."""
    recipe = Recipe(mode="causal", tuned_on=Origin(rate_hz=rate_hz), channel=(channel,))
    seen = readings[np.isfinite(readings)]
    more = 0.1 * float(np.ptp(seen))  # a reading at the end of the range is clipped
    spans = {channel.name: (float(seen.min()) - more, float(seen.max()) + more)} if more > 0 else {}
    with tempfile.TemporaryDirectory() as place:
        bundle = bundle_of(recipe, "record", ExportOptions(precision=precision, spans=spans))
        program = build(write_bundle(bundle, Path(place)), bundle.stem, "cc", ("-O2",))
        (one,) = bundle.channels
        found = compare(program, one, channel, "record", readings)
        if not is_beyond(found, precision):
            return Addition(found, 0.0, None)
        first = (
            None if one.design.modes else compare(program, one, channel, "record", readings[:_FIRST], run_specification)
        )
        return Addition(found, moved_by_digits(recipe, readings, one.kind.number.bits), first)


def is_beyond(one: RecordComparison, precision: Precision) -> bool:
    """Return whether C is less exact than required."""
    return one.error > _SAME if precision == "float64" else not one.kept


def moved_by_digits(recipe: Recipe, readings: Floats, bits: int) -> float:
    """Return the change of becalm's own stream when readings (N,) change in the last of `bits` binary digits."""
    digits = np.random.default_rng(1).uniform(-1, 1, len(readings)) * 2.0**-bits
    signals = []
    for each in (readings, readings + readings * digits):
        stream = StreamCleaner(recipe, 1 / recipe.nominal_rate_hz)
        signals.append(stream.push(each[:, np.newaxis], np.ones(len(each))).signal[:, 0])
    return float(np.nanmax(np.abs(signals[1] - signals[0])) / np.nanmax(np.abs(signals[0])))


def row_of(title: str, recording: becalm.Recording, channels: Sequence[ChannelRecipe]) -> Row:
    """Export and compare all channels of one recording."""
    found: dict[Precision, list[Addition]] = {precision: [] for precision in _PRECISIONS}
    refused: Counter[str] = Counter()
    rate_hz = recording.timebase.rate_hz
    for channel in channels:
        if channel.motion is None:
            refused["passes unchanged"] += 1
            continue
        readings = np.ascontiguousarray(recording.samples[:, recording.names.index(channel.name)])
        for precision in _PRECISIONS:
            try:
                found[precision].append(compared(channel, rate_hz, readings, precision))
            except BecalmError as why:
                refused[f"{precision}: {_short(str(why), channel.name)}"] += 1
    return Row(title, len(channels), len(recording), found, refused)


def _short(why: str, name: str) -> str:
    return why.replace(name, "it").split(";")[0].split(" (")[0]


def recordings(names: Sequence[str]) -> Iterator[tuple[str, becalm.Recording]]:
    """Yield the recordings whose path contains one of the names, with titles; print how long each took."""
    for path in files():
        if names and not any(name in str(path) for name in names):
            continue
        for part in parts(path):
            if part.recording is not None:
                title = f"{path.relative_to(DATA)}{': ' if part.title else ''}{part.title}"
                began = time.perf_counter()
                yield title, part.recording
                print(f"{title}: {time.perf_counter() - began:.0f} s", file=sys.stderr)


def records(names: Sequence[str]) -> Iterator[Row]:
    """Compare every channel of every recording."""
    for title, recording in recordings(names):
        yield row_of(title, recording, tuned(recording))


def long_record(rows: int) -> Row:
    """Compare on a long record of order 2: a sine and a walk in noise."""
    rng, rate_hz = np.random.default_rng(9), 1000.0
    walk = np.cumsum(np.cumsum(rng.normal(0, 1e-4, rows)) * 0.01)
    readings = 20 * np.sin(np.arange(rows) / 3000) + np.clip(walk, -60, 60) + rng.normal(0, 0.5, rows)
    channel = ChannelRecipe(
        name="long", unit="m/s^2", model="motion", order=2, process_noise_density=20.0, noise_std=0.5
    )
    recording = becalm.Recording(readings, names=["long"], units=["m/s^2"], rate_hz=rate_hz)
    return row_of(f"{rows:,} readings, order 2", recording, [channel])


def table(rows: Sequence[Row]) -> str:
    """Return the page's tables."""
    lines = [
        "| record | rows | channels | exported | float64, greatest difference | float32, least | q31, least |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        exported = f"{len(row.found['float64'])}, {len(row.found['float32'])}, {len(row.found['q31'])}"
        error = max((one.compared.error for one in row.found["float64"]), default=None)
        cells = [_db(row.found[name]) for name in ("float32", "q31")]
        shown = "" if error is None else f"{error:.1e}"
        lines.append(f"| {row.record} | {row.rows} | {row.channels} | {exported} | {shown} | {' | '.join(cells)} |")
    if beyond := [f"- {row.record}, {said}" for row in rows for said in _beyond(row.found)]:
        lines += ["", "Beyond 1e-12 in float64, or below 120 dB in float32, or 90 dB in q31:", "", *beyond]
    lines += ["", "*Exported* are channels as float64, float32, q31. Not exported were:", ""]
    reasons: Counter[str] = sum((row.refused for row in rows), Counter())
    lines += [f"- {count}: {why}" for why, count in reasons.most_common()] or ["- none"]
    return "\n".join(lines) + "\n"


def _beyond(found: dict[Precision, list[Addition]]) -> Iterator[str]:
    """Yield a sentence on each channel that is less exact than required."""
    for precision, every in found.items():
        for one, moved, specification in every:
            if is_beyond(one, precision):
                first = "the first signal that is told" if one.error_row == one.first_row else f"row {one.error_row}"
                itself = f"becalm's stream moves by {moved:.1e} where readings differ in their last digit"
                exact = "" if specification is None else f"; beside its specification {specification.error:.1e} off"
                off = f"{one.error:.1e} off in {first}, {one.snr_db:.0f} dB"
                yield f"{one.channel}, {precision}: {off}; {itself}{exact}"


def _db(found: Sequence[Addition]) -> str:
    least = min((one.compared.snr_db for one in found), default=None)
    return "" if least is None else "no difference" if np.isinf(least) else f"{least:.0f} dB"


def main() -> None:
    """Print the tables, and write them to a page."""
    parser = page_parser(__doc__)
    parser.add_argument("names", nargs="*", help="files whose path holds one of these")
    parser.add_argument("--long", type=int, default=_LONG, help="readings of the long record; 0 leaves it out")
    arguments = parser.parse_args()
    rows = [*([long_record(arguments.long)] if arguments.long else []), *records(arguments.names)]
    publish("What is exported, beside becalm", __doc__, table(rows), arguments.output)


if __name__ == "__main__":
    main()
