"""A verdict for every channel of every real recording, smoothed and causal, with nothing said.

Run: python docs/real_channels.py [-o docs/real-channels.md] [FILE ...]   (needs `pip install 'becalm[formats]'`)
The recordings lie in ../shared/data; with names, only files whose path holds one of them are taken.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from real_recordings import DATA, Part, files, parts

import becalm
from becalm.cleaning.report import ChannelReport

MODES = (("smoothed", False), ("causal", True))
FAILED = "failed"


class Told(NamedTuple):
    """What one part gave: its section of the page, and its verdicts by mode."""

    text: str
    kinds: dict[str, Counter[str]]


def told(part: Part) -> Told:
    """Clean one part in both ways; a refusal is a verdict on all of its channels."""
    recording = part.recording
    if recording is None:
        kinds = {mode: Counter({"refused": len(part.names)}) for mode, _ in MODES}
        return Told(f"{len(part.names)} channels refused: {_names(part.names)}.\n\n> {part.refusal}\n", kinds)
    began = time.perf_counter()
    reports = {mode: _reports(recording, causal) for mode, causal in MODES}
    taken_s = time.perf_counter() - began
    lines = [
        f"{_facts(recording)}; cleaned twice in {taken_s:.2g} s.",
        "",
        "| channel | unit | smoothed: model | noise | verdict | causal: model | noise | verdict |",
        "|---|---|---|---|---|---|---|---|",
        *(_row(*pair) for pair in zip(*reports.values(), strict=True)),
    ]
    kinds = {mode: Counter(_kind(report) for report in reports[mode]) for mode, _ in MODES}
    return Told("\n".join(lines) + "\n", kinds)


def _reports(recording: becalm.Recording, causal: bool) -> list[ChannelReport]:
    """Clean a recording; where that fails, channel by channel, so that the others get their verdict."""
    try:
        return list(becalm.clean(recording, causal=causal).reports)
    except Exception:
        return [_report(recording, name, causal) for name in recording.names]


def _report(recording: becalm.Recording, name: str, causal: bool) -> ChannelReport:
    """Clean one channel; a failure is its verdict, for all to see."""
    try:
        return becalm.clean(recording, channels=[name], causal=causal).reports[0]
    except Exception as failure:
        unit = recording.units[recording.names.index(name)]
        says = f"Failed with {type(failure).__name__}: {failure}"
        return ChannelReport(name=name, unit=unit, model=FAILED, says=says)


def sections(path: Path) -> Iterator[tuple[str, Told]]:
    """Tell what each part of a file gave, with its heading."""
    for part in parts(path):
        name = str(path.relative_to(DATA))
        yield f"{name}: {part.title}" if part.title else name, told(part)


def _names(names: tuple[str, ...]) -> str:
    return ", ".join(names) if len(names) <= 6 else f"{', '.join(names[:3])} … {names[-1]}"


def _facts(recording: becalm.Recording) -> str:
    base = recording.timebase
    even = "even time" if base.uniform else f"stamped time, jitter {base.jitter_s:.2g} s"
    holes = f", {len(base.gaps)} gaps" if len(base.gaps) else ""
    repeats = f", {len(base.repeats)} repeated stamps" if len(base.repeats) else ""
    return f"{len(recording)} rows at {base.rate_hz:.6g} Hz, {even}{holes}{repeats}"


def _row(smoothed: ChannelReport, causal: ChannelReport) -> str:
    cells = [_cell(smoothed.name), _cell(smoothed.unit)]
    for report in (smoothed, causal):
        cells += [_model(report), _noise(report), _verdict(report)]
    return f"| {' | '.join(cells)} |"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _model(report: ChannelReport) -> str:
    """Name the order of a motion and the tones beside it."""
    if report.order is None:
        return report.model
    return ", ".join([f"motion {report.order}", *(f"{tone:.4g} Hz" for tone in report.tones_hz)])


def _noise(report: ChannelReport) -> str:
    """Tell the noise; the report says where it is a guess."""
    if report.noise_std is None:
        return ""
    return f"{report.noise_std:.3g}{' (a guess)' if 'is a guess' in report.says else ''}"


def _verdict(report: ChannelReport) -> str:
    """Name the verdict, and what is much: what is still predictable and costs, and how uneven it is."""
    if report.order is None:
        return _kind(report) if report.model != FAILED else _cell(report.says)
    claim = f"{report.verdict} {report.loudest_hz:.3g} Hz" if report.verdict == "fits except" else report.verdict
    effects = []
    if (report.predictable_share or 0.0) > 0.1:
        effects.append(f"{report.predictable_share:.0%} predictable, costs {report.excess_error:.0%}")
    if (report.uneven_share or 0.0) > 0.1:
        effects.append(f"{report.uneven_share:.0%} uneven")
    return f"{claim} ({', '.join(effects)})" if effects else claim


def _kind(report: ChannelReport) -> str:
    """Sort a verdict."""
    return FAILED if report.model == FAILED else report.verdict


def _summary(found: dict[str, list[Told]]) -> str:
    """Count the verdicts of each file; columns are the kinds that came."""
    lines = []
    for mode, _ in MODES:
        counts = {name: sum((one.kinds[mode] for one in of), Counter()) for name, of in found.items()}
        total = sum(counts.values(), Counter())
        kinds = [kind for kind, _ in total.most_common()]
        lines += [f"| {mode} | channels | {' | '.join(kinds)} |", "|---" * (len(kinds) + 2) + "|"]
        for name, count in [*counts.items(), ("all", total)]:
            lines.append(f"| {name} | {count.total()} | {' | '.join(str(count[kind]) for kind in kinds)} |")
        lines.append("")
    return "\n".join(lines)


def page(paths: list[Path]) -> str:
    """Write the whole page."""
    found: dict[str, list[Told]] = {}
    text = []
    for path in paths:
        of = found.setdefault(str(path.relative_to(DATA)), [])
        for heading, one in sections(path):
            print(heading, file=sys.stderr)
            of.append(one)
            text.append(f"## {heading}\n\n{one.text}")
    return "\n".join(["# Every real channel", "", _PREFACE, _summary(found), *text])


def main() -> None:
    """Print the page; with -o, write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("files", nargs="*", help="part of a path; all files by default")
    parser.add_argument("-o", "--output", type=Path, help="page to write")
    asked = parser.parse_args()
    paths = [path for path in files() if not asked.files or any(word in str(path) for word in asked.files)]
    text = page(paths)
    if asked.output:
        asked.output.write_text(text, encoding="utf-8")
    else:
        print(text)
    if failures := text.count(f"| {FAILED} |  | "):
        sys.exit(f"{failures} verdicts are failures of becalm: look for 'Failed with' on the page.")


_PREFACE = """All channels of the real recordings, in every format, cleaned by `becalm.clean` with nothing said: once as
a smoother, once causally. Written by `docs/real_channels.py`. The files are taken whole, each of their rates for
itself. Constant channels, flags and clocks that a logger wrote are here too; texts are not.

*motion n* is a motion of order n, tones beside it by their frequency; *constant* and *untold* (too few readings) pass
unchanged. *noise* is the standard deviation of one reading's noise, in the channel's unit, and a guess where next to
nothing was removed. *predictable* is the share of the innovation power that a linear predictor still foresees,
*costs* by how much the rms error exceeds the least possible for that (a smoother's of its signal, a causal filter's of
its prediction), *uneven* the share of the record in which sigma is wrong by more than a factor of two; they are told
above 10 %. A smoother fits where what is predictable costs less than 10 %.
"""


if __name__ == "__main__":
    main()
