"""Compare becalm with classic filters; print a table or JSON on stdout."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rich.console import Console
from rich.table import Table

from becalm.cleaning.comparison import compare
from becalm.cleaning.comparison_cells import cells, headings
from becalm.cli.messages import print_notes, stderr
from becalm.cli.opened_file import AS_WRITTEN, shown_name
from becalm.files.atomic_file import make_folder, refuse_unwritable, write_text
from becalm.files.inputs.opening import open_source
from becalm.files.inputs.portions import read_beginning, unused_rows_note
from becalm.files.read_options import ReadOptions, RequestOrigin, RequiredUnits

if TYPE_CHECKING:
    from becalm.cleaning.comparison import ChannelComparison, Comparison
    from becalm.cli.opened_file import FileOptions
    from becalm.core.recording import Recording
    from becalm.files.inputs.opening import OpenSource

_WORDS = 3  # number of first columns, which have text and are left-aligned


class CompareOptions(NamedTuple):
    """The options of a comparison."""

    truth: Path | None  # a file with the true signal
    causal: bool
    folder: Path | None  # the folder of the page; None for no page


def run(source: OpenSource, file_options: FileOptions, options: CompareOptions, *, as_json: bool) -> None:
    """Compare filters on a file, or on the beginning of a long file, and print the result."""
    truth, causal, folder = options
    page = None if folder is None else _page_in(folder)
    print_notes(source)
    recording = read_beginning(source)
    true_signal = None if truth is None else _truth(truth, source, file_options)
    comparison = compare(
        recording, file_options.recipe, truth=true_signal, causal=causal or None, channels=source.names
    )
    if as_json:
        print(json.dumps(_summary(source, recording, comparison), indent=2, allow_nan=False))  # noqa: T201
    else:
        _show(comparison, true_signal is not None)
    if page is not None:
        _write(page, source, (recording, true_signal), comparison)
    if cut := unused_rows_note(source, recording):
        stderr.print(cut.strip())


def _page_in(folder: Path) -> Path:
    """Return the path of the page; raise an error, before the comparison, if it cannot be written."""
    from becalm.report.vendor import uplot

    uplot()
    make_folder(folder)
    page = folder / "compare.html"
    refuse_unwritable(page)
    return page


def _write(page: Path, source: OpenSource, read: tuple[Recording, Recording | None], comparison: Comparison) -> None:
    from becalm.report.classic_figures import comparison_figures
    from becalm.report.page import Facts, page_of
    from becalm.report.running import pictures_of

    recording, truth = read
    facts = Facts(shown_name(source.path), source.sha256())
    recipe = comparison.cleaned.recipe
    write_text(
        page, page_of(facts, recipe, pictures_of(recording, recipe), comparison_figures(comparison, recording, truth))
    )
    stderr.print(f"Wrote {page}.")


def _truth(path: Path, source: OpenSource, file_options: FileOptions) -> Recording:
    """Read the true signal of the channels of `source` from a file, with the same time options."""
    origin = RequestOrigin("The recording", " Give a truth of the same channels, or choose some with --channels.")
    fitting = RequiredUnits(origin, dict(zip(source.names, source.units, strict=True)))
    kept = file_options.stamps == AS_WRITTEN
    options = ReadOptions(
        file_options.time, file_options.rate_hz, tuple(source.names), origin, required_units=fitting, as_written=kept
    )
    with open_source(path, options) as other:
        print_notes(other)
        return read_beginning(other)


def _summary(source: OpenSource, recording: Recording, comparison: Comparison) -> dict[str, object]:
    return {
        "file": str(source.path),
        "rows": source.rows,
        "rows_looked_at": len(recording),
        "rate_hz": source.rate_hz,
        "mode": comparison.cleaned.recipe.mode,
        "channels": [
            {
                "name": channel.name,
                "unit": channel.unit,
                "says": channel.says,
                "filters": [contender._asdict() for contender in channel.contenders],
            }
            for channel in comparison.channels
        ],
    }


def _show(comparison: Comparison, with_truth: bool) -> None:
    out = Console(highlight=False, soft_wrap=True, markup=False, width=1000)  # wide, so that no number wraps
    for channel in comparison.channels:
        out.print(f"{channel.name}: {channel.says}")
        out.print(_table(channel, with_truth))


def _table(channel: ChannelComparison, with_truth: bool) -> Table:
    table = Table(box=None, pad_edge=False)
    for number, heading in enumerate(headings(with_truth)):
        table.add_column(heading, justify="left" if number < _WORDS else "right", no_wrap=True)
    for contender in channel.contenders:
        table.add_row(*cells(contender, channel.unit, with_truth))
    return table
