"""Classify cells of text as numbers, times, missing values or words, and convert them to numbers."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Booleans
from becalm.errors import InputError
from becalm.files.source import RawTable

_SPELLED = ("NaN", "nan", "NAN", "NA", "N/A", "n/a", "null", "NULL", "Null", "None", "#N/A", "#NA", "-", "--", "---")
_NOT_A_NUMBER = ("-nan", "-NaN", "+nan", "-nan(ind)", "nan(ind)", "1.#QNAN", "-1.#IND", "1.#IND")
MISSING: tuple[str, ...] = ("", *_SPELLED, *_NOT_A_NUMBER)
"""Cells that mean a missing measurement."""

_TAIL = r"(?:[eE][+-]?[0-9]+)?"  # an exponent
_ENDLESS = r"[iI][nN][fF](?:[iI][nN][iI][tT][yY])?"  # infinity
POINT = rf"^\s*[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+){_TAIL}|{_ENDLESS})\s*$"
COMMA = rf"^\s*[+-]?(?:(?:[0-9]+(?:,[0-9]+)?|,[0-9]+){_TAIL}|{_ENDLESS})\s*$"
"""Patterns of numbers with a decimal point and with a decimal comma; they mean the same to `re` and to RE2."""

THOUSANDS = {
    ".": r"^\s*[+-]?[0-9]{1,3}(?:,[0-9]{3})+\.[0-9]+\s*$",
    ",": r"^\s*[+-]?[0-9]{1,3}(?:\.[0-9]{3})+,[0-9]+\s*$",
}
"""By decimal separator, patterns of numbers whose thousands are separated by the other sign, such as 1,234.5."""

GROUPED = r"^\s*[+-]?[1-9][0-9]{0,2}(?:,[0-9]{3})+\s*$"
"""A pattern of numbers in which a comma may separate thousands or decimals: 1,002."""

_DATE_LIKE = r"\d{1,4}[-/.](?:\d{1,2}|[A-Za-z]{3})[-/.]\d{1,4}"
_CLOCK_LIKE = (
    r"\d{1,2}:\d{2}(?::\d{2}(?:[.,:]\d{1,9})?)?"
    r"\s*(?:[AaPp]\.?[Mm]\.?)?\s*(?:Z|UTC|GMT|[+-]\d{2}:?\d{2}|[+-]\d{2})?"
)
_TIME_LIKE = re.compile(rf"^\s*(?:{_DATE_LIKE}(?:[T ,;]+{_CLOCK_LIKE})?|{_CLOCK_LIKE})\s*$")
_POINT, _COMMA = re.compile(POINT), re.compile(COMMA)
_THOUSANDS = {sign: re.compile(pattern) for sign, pattern in THOUSANDS.items()}
_MISSING = frozenset(MISSING)

NUMBER, TIME, MISSING_CELL, WORDS = "number", "time", "missing", "words"
"""Kinds of cells: a number, a date or time, a missing value, and any other text."""


def split(line: str, separator: str) -> list[str]:
    """Split a line into cells; the separator " " stands for runs of spaces, "" for a line of one cell."""
    if separator == " ":
        return line.split()
    if separator == "":
        return [line.strip().strip('"')]
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:  # the cell exceeds the length limit of the csv module, so this is not a table
        return [line]


def kind_of(cell: str) -> str:
    """Return the kind of a cell; numbers may have either decimal separator."""
    if cell.strip() in _MISSING:
        return MISSING_CELL
    if _POINT.match(cell) or _COMMA.match(cell) or any(one.match(cell) for one in _THOUSANDS.values()):
        return NUMBER
    return TIME if _TIME_LIKE.match(cell) else WORDS


def decimal_of(cell: str) -> str:
    """Return the decimal separator of a number, "" for whole numbers and other cells."""
    if "." in cell and (_POINT.match(cell) or _THOUSANDS["."].match(cell)):
        return "."
    return "," if "," in cell and (_COMMA.match(cell) or _THOUSANDS[","].match(cell)) else ""


def grouped_error(path: Path, cell: str) -> InputError:
    """Return the error that a number like 1,002 can be read in two ways."""
    return InputError(
        f"{path} holds {cell.strip()!r}, and nothing in it shows whether the comma separates thousands or decimals."
        " Save the numbers without separators of thousands, and fractions with decimal points."
    )


def is_row(line: str, separator: str, kinds: Sequence[str]) -> bool:
    """Return whether a line has enough cells for a row, and numbers and times in most of the columns that need them.

    Quotes are ignored, because any quote may be a stray one; separators within quotes count too.

    Parameters
    ----------
    line : str
        A line of text without its line end.
    separator : str
        The separator, as in `Dialect`.
    kinds : sequence of str
        The kind of each column.
    """
    cells = [cell.strip('" \t') for cell in (line.split(separator or "\x1f") if line else ())]
    width = len(kinds)
    if len(cells) < width:
        return False
    signals = (column for column, kind in enumerate(kinds) if kind in (NUMBER, TIME))
    # If there are extra separators, each column is tested at its position from the left and from the right.
    cell_kinds = [{kind_of(cells[column]), kind_of(cells[column - width])} for column in signals]
    return 2 * cell_kinds.count({WORDS}) <= len(cell_kinds)


def is_left_open(line: str, separator: str) -> bool:
    """Return whether a quoted cell begins in a line and does not end in it."""
    try:
        return len(list(csv.reader([line + "\n", "next"], delimiter=separator or "\x1f"))) == 1
    except csv.Error:  # the cell exceeds the length limit of the csv module
        return False


def to_numbers(text: pa.Array, decimal: str) -> tuple[pa.Array, Booleans]:
    """Convert a column of text to numbers.

    Parameters
    ----------
    text : pyarrow.Array of str
        The cells.
    decimal : str
        The decimal separator, "." or ",".

    Returns
    -------
    pyarrow.Array of float64
        The numbers, null where a cell is missing or is not a number.
    (N,) bool array
        True where a cell is neither a number nor missing.
    """
    trimmed = pc.utf8_trim_whitespace(text.cast(pa.string()))
    has_thousands = pc.match_substring_regex(trimmed, THOUSANDS["," if decimal == "," else "."])
    if pc.any(has_thousands).as_py():
        joined = pc.replace_substring(trimmed, "." if decimal == "," else ",", "")
        trimmed = pc.if_else(has_thousands, joined, trimmed)
    missing = pc.fill_null(pc.is_in(trimmed, value_set=pa.array(MISSING)), True)
    fits = pc.fill_null(pc.match_substring_regex(trimmed, COMMA if decimal == "," else POINT), False)
    plain = pc.replace_substring_regex(trimmed, r"^\+", "")
    if decimal == ",":
        plain = pc.replace_substring(plain, ",", ".")
    readable = pc.and_(fits, pc.invert(missing))
    numbers = pc.if_else(readable, plain, pa.scalar(None, pa.string())).cast(pa.float64())
    bad = ~(np.asarray(missing) | np.asarray(fits))
    return numbers, bad


# Count the cells of a column of text that are not numbers, and locate the first.


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
        """Return whether there are more numbers than bad cells, so that the column is meant to hold numbers."""
        return self.cells < self.numbers


def is_text(kind: pa.DataType) -> bool:
    """Return whether a column type is text."""
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def find_bad_cells(raw: RawTable, name: str) -> BadCells:
    """Count the cells of a column of text that are not numbers, and find the first."""
    bad, row = BadCells(), 0
    for column in raw.column(name):
        bad = _added(bad, column, raw.decimal, row)
        row += len(column)
    return bad


def meant_as_numbers(raw: RawTable, name: str) -> bool:
    """Return whether a column of text in a CSV file has more numbers than bad cells in its first rows."""
    if raw.format != "csv" or not is_text(raw.type_of(name)):
        return False
    return _added(BadCells(), raw.head.column(name), raw.decimal, 0).few


def bad_cell(raw: RawTable, name: str, bad: BadCells, advice: str) -> InputError:
    """Return the error that names the first bad cell; `advice` continues the sentence "Correct the cell"."""
    more = f" ({bad.cells} such cells)" if bad.cells > 1 else ""
    return InputError(
        f"Column {name!r} holds {bad.cell!r} in {raw.place(bad.row)}, which is not a number{more}."
        f" Correct the cell{advice}."
    )


def _added(before: BadCells, column: pa.ChunkedArray, decimal: str, row: int) -> BadCells:
    parsed, bad = to_numbers(column.combine_chunks(), decimal)
    if not before.cells and bad.any():
        at = int(np.flatnonzero(bad)[0])
        before = before._replace(row=row + at, cell=str(column[at].as_py())[:40])
    good = len(parsed) - parsed.null_count
    return before._replace(cells=before.cells + int(bad.sum()), numbers=before.numbers + good)


# Leave out rows that consist of separators only, which some loggers write at the end of a file.


def without_blank_end(raw: RawTable, found: list[tuple[str, ...]]) -> int:
    """Return the number of rows without blank rows at the end; all rows without a time column, and for other formats.

    Parameters
    ----------
    raw : RawTable
        The file.
    found : list of tuple of str
        The candidates for the time from `find_time`.
    """
    rows = raw.count
    if raw.format != "csv" or not found:
        return rows
    length = 256
    while rows > 1:
        start = max(0, rows - length)
        table = pa.concat_tables(list(raw.blocks(raw.names, start, most_rows=length)))
        last = table.num_rows - (raw.count - rows)
        while last > 0 and rows > 1 and _is_blank(table, last - 1):
            last -= 1
            rows -= 1
        if last > 0:
            return rows
    return rows


def _is_blank(table: pa.Table, row: int) -> bool:
    return all(column[row].as_py() in (None, "") for column in table.columns)
