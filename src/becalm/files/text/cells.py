"""What a cell of text holds: a number, a time, nothing, or words."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Booleans

_SPELLED = ("NaN", "nan", "NAN", "NA", "N/A", "n/a", "null", "NULL", "Null", "None", "#N/A", "#NA", "-", "--", "---")
_NOT_A_NUMBER = ("-nan", "-NaN", "+nan", "-nan(ind)", "nan(ind)", "1.#QNAN", "-1.#IND", "1.#IND")
MISSING: tuple[str, ...] = ("", *_SPELLED, *_NOT_A_NUMBER)
"""Cells that stand for a reading that is not there."""

_TAIL = r"(?:[eE][+-]?[0-9]+)?"
_ENDLESS = r"[iI][nN][fF](?:[iI][nN][iI][tT][yY])?"
POINT = rf"^\s*[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+){_TAIL}|{_ENDLESS})\s*$"
COMMA = rf"^\s*[+-]?(?:(?:[0-9]+(?:,[0-9]+)?|,[0-9]+){_TAIL}|{_ENDLESS})\s*$"
"""Numbers with a decimal point and with a decimal comma; understood alike by `re` and by RE2."""

THOUSANDS = {
    ".": r"^\s*[+-]?[0-9]{1,3}(?:,[0-9]{3})+\.[0-9]+\s*$",
    ",": r"^\s*[+-]?[0-9]{1,3}(?:\.[0-9]{3})+,[0-9]+\s*$",
}
"""Numbers that show both signs, so that one must part thousands, by their decimal sign."""

_DATE_LIKE = r"\d{1,4}[-/.](?:\d{1,2}|[A-Za-z]{3})[-/.]\d{1,4}"
_CLOCK_LIKE = (
    r"\d{1,2}:\d{2}(?::\d{2}(?:[.,:]\d{1,9})?)?"
    r"\s*(?:[AaPp]\.?[Mm]\.?)?\s*(?:Z|UTC|GMT|[+-]\d{2}:?\d{2}|[+-]\d{2})?"
)
_TIME_LIKE = re.compile(rf"^\s*(?:{_DATE_LIKE}(?:[T ,;]+{_CLOCK_LIKE})?|{_CLOCK_LIKE})\s*$")
_POINT, _COMMA = re.compile(POINT), re.compile(COMMA)
_THOUSANDS = {sign: re.compile(pattern) for sign, pattern in THOUSANDS.items()}
_MISSING = frozenset(MISSING)

NUMBER, TIME, GONE, WORDS = "number", "time", "missing", "words"


def split(line: str, separator: str) -> list[str]:
    """Cut a line into cells; " " stands for runs of spaces, "" for one cell."""
    if separator == " ":
        return line.split()
    if separator == "":
        return [line.strip().strip('"')]
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:  # a cell beyond the module's limit: no table has such
        return [line]


def kind_of(cell: str) -> str:
    """Tell what one cell holds, with either decimal sign."""
    if cell.strip() in _MISSING:
        return GONE
    if _POINT.match(cell) or _COMMA.match(cell) or any(one.match(cell) for one in _THOUSANDS.values()):
        return NUMBER
    return TIME if _TIME_LIKE.match(cell) else WORDS


def decimal_of(cell: str) -> str:
    """Return the decimal sign that a number shows, "" for whole numbers and all else."""
    if "." in cell and (_POINT.match(cell) or _THOUSANDS["."].match(cell)):
        return "."
    return "," if "," in cell and (_COMMA.match(cell) or _THOUSANDS[","].match(cell)) else ""


def is_row(line: str, separator: str, kinds: Sequence[str]) -> bool:
    """Tell whether a line has cells enough for a row, and numbers and times where they are needed.

    Separators within its cells are counted as well: nobody knows which of its quotes are strays.

    Parameters
    ----------
    line : str
        Part of a text, without its line end.
    separator : str
        As in `Dialect`.
    kinds : sequence of str
        What each column holds.
    """
    cells = [cell.strip('" \t') for cell in (line.split(separator or "\x1f") if line else ())]
    width = len(kinds)
    if len(cells) < width:
        return False
    signals = (column for column, kind in enumerate(kinds) if kind in (NUMBER, TIME))
    found = [{kind_of(cells[column]), kind_of(cells[column - width])} for column in signals]
    return 2 * found.count({WORDS}) <= len(found)


def is_left_open(line: str, separator: str) -> bool:
    """Tell whether a quoted cell begins in a line and does not end in it."""
    try:
        return len(list(csv.reader([line + "\n", "next"], delimiter=separator or "\x1f"))) == 1
    except csv.Error:  # a cell beyond the module's limit
        return False


def to_numbers(text: pa.Array, decimal: str) -> tuple[pa.Array, Booleans]:
    """Read a column of text as numbers.

    Parameters
    ----------
    text : pyarrow.Array of str
        The cells.
    decimal : str
        "." or ",".

    Returns
    -------
    pyarrow.Array of float64
        The numbers, null where a cell is missing or no number.
    (N,) bool array
        True where a cell is neither a number nor missing.
    """
    trimmed = pc.utf8_trim_whitespace(text.cast(pa.string()))
    parted = pc.match_substring_regex(trimmed, THOUSANDS["," if decimal == "," else "."])
    if pc.any(parted).as_py():
        whole = pc.replace_substring(trimmed, "." if decimal == "," else ",", "")
        trimmed = pc.if_else(parted, whole, trimmed)
    gone = pc.fill_null(pc.is_in(trimmed, value_set=pa.array(MISSING)), True)
    fits = pc.fill_null(pc.match_substring_regex(trimmed, COMMA if decimal == "," else POINT), False)
    plain = pc.replace_substring_regex(trimmed, r"^\+", "")
    if decimal == ",":
        plain = pc.replace_substring(plain, ",", ".")
    readable = pc.and_(fits, pc.invert(gone))
    numbers = pc.if_else(readable, plain, pa.scalar(None, pa.string())).cast(pa.float64())
    bad = ~(np.asarray(gone) | np.asarray(fits))
    return numbers, bad
