"""Write the figures of a study as SVG files, if matplotlib is installed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from becalm.files.atomic_file import write_bytes
from becalm.report.data.description import Figure
from becalm.report.printing import can_print, printed

NOT_DRAWN = "No figures: drawing them needs matplotlib; type `pip install 'becalm[figures]'`."
"""Text of a page without figures."""


class SheetContents(NamedTuple):
    """The contents of one file."""

    name: str  # name of the file without its ending
    figures: tuple[Figure, ...]  # row by row
    columns: int = 1


def draw(sheets: Iterable[SheetContents], folder: Path) -> tuple[Path, ...]:
    """Draw each sheet as an SVG file in an existing folder; return the paths, none if matplotlib is not installed.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    if not can_print():
        return ()
    return tuple(_drawn(sheet, folder / f"{sheet.name}.svg") for sheet in sheets)


def _drawn(sheet: SheetContents, path: Path) -> Path:
    write_bytes(path, printed(sheet.figures, "svg", sheet.columns))
    return path
