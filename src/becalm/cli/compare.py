"""becalm beside the classic filters: a table for a person, or JSON, on stdout."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from becalm.cleaning.comparison import compare
from becalm.cli.portions import beginning, cut_short
from becalm.cli.talk import stderr
from becalm.cli.warm import ahead
from becalm.files.opening import open_source
from becalm.files.source import Asker, ReadOptions

if TYPE_CHECKING:
    from becalm.cleaning.comparison import ChannelComparison, Comparison, Contender
    from becalm.cli.said import Said
    from becalm.core.recording import Recording
    from becalm.files.opening import OpenSource

_HEADINGS = ("filter", "setting", "at", "noise removed", "lag", "overshoot", "rms error", "lag found")
_WITHOUT_TRUTH = 6  # of them
_NOTHING = 1e-9  # of whatever unit: rounding


def run(source: OpenSource, said: Said, truth: Path | None, causal: bool, as_json: bool) -> None:
    """Compare on a file, or on the beginning of a long one, and show what came out."""
    recording = beginning(source)
    ahead(recording, causal=causal)
    true = None if truth is None else _truth(truth, source, said)
    found = compare(recording, said.recipe, truth=true, causal=causal or None, channels=source.names)
    if as_json:
        print(json.dumps(_summary(source, recording, found), indent=2, allow_nan=False))  # noqa: T201
    else:
        _show(found)
    if cut := cut_short(source, recording):
        stderr.print(cut.strip())


def _truth(path: Path, source: OpenSource, said: Said) -> Recording:
    """Read the same channels of the truth; what was said of time holds for both files."""
    asker = Asker("The recording", " Give a truth of the same channels, or choose some with --channels.")
    with open_source(path, ReadOptions(said.time, said.rate_hz, tuple(source.names), asker)) as other:
        return beginning(other)


def _summary(source: OpenSource, recording: Recording, found: Comparison) -> dict[str, object]:
    return {
        "file": str(source.path),
        "rows": source.rows,
        "rows_looked_at": len(recording),
        "rate_hz": source.rate_hz,
        "mode": found.cleaned.recipe.mode,
        "channels": [
            {
                "name": channel.name,
                "unit": channel.unit,
                "says": channel.says,
                "filters": [contender._asdict() for contender in channel.contenders],
            }
            for channel in found.channels
        ],
    }


def _show(found: Comparison) -> None:
    out = Console(highlight=False, soft_wrap=True, markup=False, width=1000)  # breaks no figure
    for channel in found.channels:
        out.print(f"{channel.name}: {channel.says}")
        out.print(_table(channel))


def _table(channel: ChannelComparison) -> Table:
    """Lay out a channel; without truth, what only truth tells is left out."""
    true = any(contender.rms_error is not None for contender in channel.contenders)
    headings = _HEADINGS if true else _HEADINGS[:_WITHOUT_TRUTH]
    table = Table(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify="left" if heading in _HEADINGS[:3] else "right", no_wrap=True)
    for contender in channel.contenders:
        table.add_row(*_cells(contender, channel.unit)[: len(headings)])
    return table


def _cells(contender: Contender, unit: str) -> tuple[str, ...]:
    return (
        contender.name,
        "" if contender.cutoff_hz is None else f"{contender.cutoff_hz:.4g} Hz",
        contender.rule,
        _told(contender.noise_removed_db, "{:.1f} dB"),
        _told(contender.lag_s, "{:.4g} s"),
        _told(contender.overshoot_percent, "{:.0f} %"),
        _told(contender.rms_error, "{:.4g} " + unit).rstrip(),
        _told(contender.measured_lag_s, "{:.4g} s"),
    )


def _told(value: float | None, form: str) -> str:
    return "" if value is None else form.format(0.0 if abs(value) < _NOTHING else value)
