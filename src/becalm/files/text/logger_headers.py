"""Read the special headers that some loggers and oscilloscopes write above the rows."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

from becalm.files.unit_spelling import tidy_unit

_STATION, _LABVIEW, _X = "TOA5", "LabVIEW Measurement", "X_Value"
_CAMPBELL_ROWS = 4  # the station, names, units, and how each value was processed
_NO_UNITS = ("TS", "RN", "Sequence", "unix time")  # texts in the row of units of stamps and record numbers
_COMMENT_NAME = "Comment"  # a name without a cell in rows that have no comment
_DEVICE = re.compile(r"calc|[0-9]+: ?\w+")  # the source of a channel in files of RaceChrono
_STEP = re.compile(r"t(?:0|Inc)\s*=.*")  # in Rigol's row of names, without cells below

Rows = Sequence[Sequence[str]]


class LoggerHeader(NamedTuple):
    """Names and units of columns, and the number of rows at the end of a header that hold them."""

    names: list[str]
    units: list[str]
    used: int


def logger_header(rows: Rows, width: int) -> LoggerHeader | None:
    """Return the names and units in the header of a known logger, None for other headers.

    Parameters
    ----------
    rows : sequence of sequence of str
        The cells of all lines above the data that are not blank.
    width : int
        Number of columns of the table.
    """
    return next((header for kind in _KINDS if (header := kind(rows, width))), None)


def _campbell(rows: Rows, width: int) -> LoggerHeader | None:
    if rows[0][0] != _STATION or len(rows) != _CAMPBELL_ROWS:
        return None
    return LoggerHeader(list(rows[1]), _units(rows[2]), 2)


def _labview(rows: Rows, width: int) -> LoggerHeader | None:
    if rows[0][0] != _LABVIEW:
        return None
    entries = {row[0]: row[1:] for row in rows}
    names = list(rows[-1])
    if len(names) == width + 1 and names[-1] == _COMMENT_NAME:
        names.pop()
    first = "s" if "Time" in entries.get("X_Dimension", ()) else ""
    units = iter(_units(entries.get("Y_Unit_Label", ())))
    return LoggerHeader(names, [first if name == _X else next(units, "") for name in names], 1)


def _racechrono(rows: Rows, width: int) -> LoggerHeader | None:
    if len(rows) < 3 or {len(row) for row in rows[-3:]} != {width} or not all(map(_DEVICE.fullmatch, rows[-1])):
        return None
    return LoggerHeader(list(rows[-3]), _units(rows[-2]), 3)


def _inca(rows: Rows, width: int) -> LoggerHeader | None:
    """Read a header of INCA: the row of names begins with `time`, and the last row holds the units."""
    first = next((number for number, row in enumerate(rows) if row[0] == "time" and len(row) == width), 0)
    if not rows[0][0].startswith("ETASAsciiItem") or not first or len(rows[-1]) != width:
        return None
    return LoggerHeader(list(rows[first]), _units(rows[-1]), len(rows) - first)


def _siglent(rows: Rows, width: int) -> LoggerHeader | None:
    if len(rows) < 2 or rows[-2][0] != "Source" or rows[-1][0] != "Second":
        return None
    return LoggerHeader(["Time", *rows[-2][1:]], _units(rows[-1]), 2)


def _rigol(rows: Rows, width: int) -> LoggerHeader | None:
    if any(map(_STEP.fullmatch, rows[-1])):
        return LoggerHeader(["" if _STEP.fullmatch(name) else name for name in rows[-1]][:width], [], 1)
    if len(rows) < 2 or rows[-1][0] != "Sequence" or "Increment" not in rows[-2]:
        return None
    count = rows[-2].index("Start")
    blank = [""] * (width - count)
    return LoggerHeader([*rows[-2][:count], *blank], [*_units(rows[-1][:count]), *blank], 2)


def _gulf_coast(rows: Rows, width: int) -> LoggerHeader | None:
    """Read a header of Gulf Coast Data Concepts; their times are in seconds."""
    if rows[-1][0] != "Headers" or len(rows[-1]) != width + 1:
        return None
    return LoggerHeader(list(rows[-1][1:]), ["s"] if rows[-1][1].lower() == "time" else [], 1)


def _units(cells: Sequence[str]) -> list[str]:
    return ["" if cell in _NO_UNITS else tidy_unit(cell) for cell in cells]


_KINDS: tuple[Callable[[Rows, int], LoggerHeader | None], ...] = (
    _campbell,
    _labview,
    _racechrono,
    _inca,
    _siglent,
    _rigol,
    _gulf_coast,
)
