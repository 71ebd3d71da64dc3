"""Count the cells of a column of text that are not numbers, and locate the first."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.errors import InputError
from becalm.files.source import RawTable
from becalm.files.text.cells import to_numbers


class BadCells(NamedTuple):
    """The bad cells in a column of text.

    Attributes
    ----------
    cells : int
        Number of cells that are neither numbers nor missing.
    numbers : int
        Number of cells that are numbers.
    row : int
        Row of the first bad cell, counted from 0.
    cell : str
        The text of the first bad cell.
    """

    cells: int = 0
    numbers: int = 0
    row: int = 0
    cell: str = ""

    @property
    def few(self) -> bool:
        """Whether there are more numbers than bad cells, so that the column is meant to hold numbers."""
        return self.cells < self.numbers


def is_text(kind: pa.DataType) -> bool:
    """Return whether a column type is text."""
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def find_bad_cells(raw: RawTable, name: str) -> BadCells:
    """Search a column of text for cells that are not numbers."""
    bad, row = BadCells(), 0
    for column in raw.column(name):
        bad = _added(bad, column, raw.decimal, row)
        row += len(column)
    return bad


def meant_as_numbers(raw: RawTable, name: str) -> bool:
    """Return whether a column of text in a text file has numbers and few bad cells, judged by its first rows."""
    if raw.format != "csv" or not is_text(raw.type_of(name)):
        return False
    return _added(BadCells(), raw.head.column(name), raw.decimal, 0).few


def bad_cell(raw: RawTable, name: str, bad: BadCells, way_out: str) -> InputError:
    """Return the error that names the first bad cell; `way_out` continues the sentence "Correct the cell"."""
    more = f" ({bad.cells} such cells)" if bad.cells > 1 else ""
    return InputError(
        f"Column {name!r} holds {bad.cell!r} in {raw.place(bad.row)}, which is not a number{more}."
        f" Correct the cell{way_out}."
    )


def _added(before: BadCells, column: pa.ChunkedArray, decimal: str, row: int) -> BadCells:
    parsed, bad = to_numbers(column.combine_chunks(), decimal)
    if not before.cells and bad.any():
        at = int(np.flatnonzero(bad)[0])
        before = before._replace(row=row + at, cell=str(column[at].as_py())[:40])
    good = len(parsed) - parsed.null_count
    return before._replace(cells=before.cells + int(bad.sum()), numbers=before.numbers + good)
