"""Print messages on stderr: progress, tables and judgements."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from becalm.cleaning.channels.report import ChannelReport
    from becalm.files.inputs.opening import OpenSource
    from becalm.identification.wishes.gain_of_waiting import Delay

_MOST_NAMED = 8  # largest number of channel names before a sentence
stderr = Console(stderr=True, highlight=False, soft_wrap=True, markup=False)


@contextmanager
def progress(title: str, count: int) -> Iterator[Callable[[str, int], None]]:
    """Show a progress bar of `count` steps on a terminal; yield a function of a name and a number of new steps."""
    from rich.progress import Progress

    with Progress(console=stderr, transient=True, disable=not stderr.is_terminal) as bar:
        task = bar.add_task(title, total=count)
        yield lambda name, steps: bar.update(task, advance=steps, description=f"{title} {name}".strip())


def print_reports(reports: tuple[ChannelReport, ...], causal: bool) -> None:
    """Print a table of the channels, then the judgements that a user must read."""
    from becalm.cleaning.channels.judging import DESCRIBED
    from becalm.cleaning.channels.report import cells

    table = Table(box=None, pad_edge=False)
    for heading in ("channel", "model", "noise", "bandwidth", "lag", "trust"):
        table.add_column(heading, justify="right" if heading in ("noise", "bandwidth", "lag") else "left")
    for report in reports:
        table.add_row(report.name, *cells(report, causal))
    stderr.print(table)
    names_by_sentence: dict[str, list[str]] = {}
    for report in reports:
        if report.says != DESCRIBED:
            names_by_sentence.setdefault(report.says, []).append(report.name)
    for says, names in names_by_sentence.items():
        more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
        stderr.print(f"{', '.join(names[:_MOST_NAMED])}{more}: {says}")


def print_delays(delays: dict[str, tuple[Delay, ...]]) -> None:
    """Print the trade-off curve of each channel on one line: the remaining error for each delay of the output."""
    if delays:
        stderr.print("Remaining error, relative to the noise of a reading, for a delay of the output (see --lag):")
    for name, curve in delays.items():
        figures = ", ".join(f"{one.wait_s * 1e3:.4g} ms {one.left_db:.1f} dB" for one in curve)
        stderr.print(f"{name}: {figures} (the limit)")


def print_not_removed(reports: tuple[ChannelReport, ...], removed_hz: tuple[float, ...]) -> None:
    """Print the frequencies of --remove near which no tone was found, and the channels concerned."""
    removed = {
        report.name: {min(removed_hz, key=lambda wanted: abs(wanted - tone)) for tone in report.removed_hz}
        for report in (reports if removed_hz else ())
    }
    for frequency in removed_hz:
        lacking = [name for name, tones in removed.items() if frequency not in tones]
        if lacking:
            stderr.print(
                f"No tone stands out near {frequency:.6g} Hz in {', '.join(lacking)}: nothing was removed there."
            )


def print_bands(source: OpenSource, reports: tuple[ChannelReport, ...] = ()) -> None:
    """Print which channels exceed the flat band of their sensors, after filtering or, without `reports`, before it."""
    from becalm.cleaning.channels.slopes import resonance_warning

    passed = {one.name: max((one.bandwidth_hz, *one.tones_hz)) for one in reports if one.bandwidth_hz is not None}
    for name, calibration in source.calibrations.items():
        if calibration.resonance is None or name not in source.names:
            continue
        if warning := resonance_warning(name, calibration.resonance, passed.get(name), source.rate_hz):
            stderr.print(warning)


def print_notes(*sources: OpenSource) -> None:
    """Print the notes on files, without repeated sentences."""
    for note in dict.fromkeys(note for source in sources for note in source.notes):
        stderr.print(note)


def print_columns(source: OpenSource) -> None:
    """Print which columns were replaced, and which passed through unchanged."""
    passed = [f"{column.name} ({column.why})" for column in source.columns if column.role == "passed through"]
    if source.replaced:
        stderr.print(f"Replaced by the new uncertainty: {', '.join(source.replaced)}.")
    if kept := [text for text in passed if text.partition(" (")[0] not in source.replaced]:
        stderr.print(f"Passed through unchanged: {', '.join(kept[:20])}{' and more' if len(kept) > 20 else ''}.")
