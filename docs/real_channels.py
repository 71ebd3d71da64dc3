"""Clean every channel of every real recording without options, smoothed and causal, and list the verdicts.

Run: python docs/real_channels.py [-o docs/real-channels.md] [FILE ...]   (needs `pip install 'becalm[formats]'`)
The recordings are in ../shared/data; with arguments, only files whose path contains one of them are processed.
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
from becalm.cleaning.channels.report import ChannelReport

MODES = (("smoothed", False), ("causal", True))
FAILED = "failed"


class PartResult(NamedTuple):
    """The section of the page on one part, and the counts of its verdicts by mode."""

    text: str
    kinds: dict[str, Counter[str]]


def clean_part(part: Part) -> PartResult:
    """Clean one part in both modes; a refusal counts as the verdict of each of its channels."""
    recording = part.recording
    if recording is None:
        kinds = {mode: Counter({"refused": len(part.names)}) for mode, _ in MODES}
        return PartResult(f"{len(part.names)} channels refused: {_names(part.names)}.\n\n> {part.refusal}\n", kinds)
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
    return PartResult("\n".join(lines) + "\n", kinds)


def _reports(recording: becalm.Recording, causal: bool) -> list[ChannelReport]:
    """Clean a recording; if that fails, clean each channel alone, so that the other channels get their verdict."""
    try:
        return list(becalm.clean(recording, causal=causal).reports)
    except Exception:
        return [_report(recording, name, causal) for name in recording.names]


def _report(recording: becalm.Recording, name: str, causal: bool) -> ChannelReport:
    """Clean one channel; a failure is shown as its verdict."""
    try:
        return becalm.clean(recording, channels=[name], causal=causal).reports[0]
    except Exception as failure:
        unit = recording.units[recording.names.index(name)]
        says = f"Failed with {type(failure).__name__}: {failure}"
        return ChannelReport(name=name, unit=unit, model=FAILED, says=says)


def sections(path: Path) -> Iterator[tuple[str, PartResult]]:
    """Yield the heading and the result of each part of a file."""
    for part in parts(path):
        name = str(path.relative_to(DATA))
        yield f"{name}: {part.title}" if part.title else name, clean_part(part)


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
    """Return the order of the kinematic model and the frequencies of the tones."""
    if report.order is None:
        return report.model
    return ", ".join([f"motion {report.order}", *(f"{tone:.4g} Hz" for tone in report.tones_hz)])


def _noise(report: ChannelReport) -> str:
    """Return the noise standard deviation; mark it if the report calls it a guess."""
    if report.noise_std is None:
        return ""
    return f"{report.noise_std:.3g}{' (a guess)' if 'is a guess' in report.says else ''}"


def _verdict(report: ChannelReport) -> str:
    """Return the verdict, with the shares of predictable power and of wrong sigma if they exceed 10 %."""
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
    """Return the verdict for counting; a failure of becalm counts as one kind."""
    return FAILED if report.model == FAILED else report.verdict


def _summary(found: dict[str, list[PartResult]]) -> str:
    """Return tables with the counts of each file's verdicts; their columns are the verdicts that occur."""
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
    """Return the whole page."""
    found: dict[str, list[PartResult]] = {}
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
    arguments = parser.parse_args()
    paths = [path for path in files() if not arguments.files or any(word in str(path) for word in arguments.files)]
    text = page(paths)
    if arguments.output:
        arguments.output.write_text(text, encoding="utf-8")
    else:
        print(text)
    if failures := text.count(f"| {FAILED} |  | "):
        sys.exit(f"{failures} verdicts are failures of becalm: look for 'Failed with' on the page.")


_PREFACE = """All channels of the real recordings, in every format, cleaned by `becalm.clean` without options: once as a
smoother, once causally. Written by `docs/real_channels.py`. Whole files are cleaned, each sampling rate of a file
separately. Constant channels, flags and clocks that a logger wrote are included; texts are not.

*motion n* is a kinematic model of order n, followed by the frequencies of tones; *constant* and *untold* (too few
readings) pass unchanged. *noise* is the standard deviation of the noise of a reading, in the channel's unit; it is a
guess if next to nothing was removed. *predictable* is the share of the innovation power that a linear predictor can
predict, *costs* is the resulting excess of the rms error over the least possible one (of the signal for a smoother, of
the prediction for a causal filter), and *uneven* is the share of the record in which sigma is wrong by more than a
factor of two; shares above 10 % are shown. A smoother fits if *costs* is below 10 %.
"""


if __name__ == "__main__":
    main()
