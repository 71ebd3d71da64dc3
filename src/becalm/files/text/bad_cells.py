"""Cells of text in columns of numbers: how many, and where the first is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.errors import InputError
from becalm.files.source import RawTable
from becalm.files.text.cells import to_numbers


class BadCells(NamedTuple):
    """What was found in a column of text.

    Attributes
    ----------
    cells : int
        Cells that are neither numbers nor missing.
    numbers : int
        Cells that are numbers.
    row : int
        Where the first of the bad ones is, counted from 0.
    cell : str
        What it holds.
    """

    cells: int = 0
    numbers: int = 0
    row: int = 0
    cell: str = ""

    @property
    def few(self) -> bool:
        """Whether the column is meant to hold numbers; a column of text is no mistake."""
        return self.cells < self.numbers


def is_text(kind: pa.DataType) -> bool:
    """Tell whether a column holds text."""
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def find_bad_cells(raw: RawTable, name: str) -> BadCells:
    """Look through a column of text for cells that are no numbers."""
    found, row = BadCells(), 0
    for column in raw.column(name):
        found = _added(found, column, raw.decimal, row)
        row += len(column)
    return found


def meant_as_numbers(raw: RawTable, name: str) -> bool:
    """Tell by its first cells whether a text file's column of text is one of numbers with a few bad cells."""
    if raw.format != "csv" or not is_text(raw.type_of(name)):
        return False
    return _added(BadCells(), raw.head.column(name), raw.decimal, 0).few


def bad_cell(raw: RawTable, name: str, bad: BadCells, way_out: str) -> InputError:
    """Say where the first bad cell is; `way_out` goes on after "Mend the cell"."""
    more = f" ({bad.cells} such cells)" if bad.cells > 1 else ""
    return InputError(
        f"Column {name!r} holds {bad.cell!r} in {raw.place(bad.row)}, which is not a number{more}."
        f" Mend the cell{way_out}."
    )


def _added(found: BadCells, column: pa.ChunkedArray, decimal: str, row: int) -> BadCells:
    parsed, bad = to_numbers(column.combine_chunks(), decimal)
    if not found.cells and bad.any():
        at = int(np.flatnonzero(bad)[0])
        found = found._replace(row=row + at, cell=str(column[at].as_py())[:40])
    good = len(parsed) - parsed.null_count
    return found._replace(cells=found.cells + int(bad.sum()), numbers=found.numbers + good)
