"""What stands above the rows of loggers and oscilloscopes that write a head of their own kind."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

from becalm.files.unit_spelling import tidy_unit

_STATION, _LABVIEW, _X = "TOA5", "LabVIEW Measurement", "X_Value"
_CAMPBELL_ROWS = 4  # the station, names, units, and what was stored of each
_NO_UNITS = ("TS", "RN", "Sequence", "unix time")  # a stamp, and the number of the record
_COMMENT = "Comment"  # a name above cells that rows without a comment leave out
_DEVICE = re.compile(r"calc|[0-9]+: ?\w+")  # where a channel of RaceChrono comes from
_STEP = re.compile(r"t(?:0|Inc)\s*=.*")  # in Rigol's row of names, above nothing

Rows = Sequence[Sequence[str]]


class LoggerHeader(NamedTuple):
    """Names and units of columns, and how many rows at the end of a head hold them."""

    names: list[str]
    units: list[str]
    used: int


def logger_header(rows: Rows, width: int) -> LoggerHeader | None:
    """Return what a head of a known kind says, None if no such logger wrote this.

    Parameters
    ----------
    rows : sequence of sequence of str
        The cells of all lines above the data that are not blank.
    width : int
        Columns of the table.
    """
    return next((known for kind in _KINDS if (known := kind(rows, width))), None)


def _campbell(rows: Rows, width: int) -> LoggerHeader | None:
    if rows[0][0] != _STATION or len(rows) != _CAMPBELL_ROWS:
        return None
    return LoggerHeader(list(rows[1]), _units(rows[2]), 2)


def _labview(rows: Rows, width: int) -> LoggerHeader | None:
    if rows[0][0] != _LABVIEW:
        return None
    told = {row[0]: row[1:] for row in rows}
    names = list(rows[-1])
    if len(names) == width + 1 and names[-1] == _COMMENT:
        names.pop()
    first = "s" if "Time" in told.get("X_Dimension", ()) else ""
    left = iter(_units(told.get("Y_Unit_Label", ())))
    return LoggerHeader(names, [first if name == _X else next(left, "") for name in names], 1)


def _racechrono(rows: Rows, width: int) -> LoggerHeader | None:
    if len(rows) < 3 or {len(row) for row in rows[-3:]} != {width} or not all(map(_DEVICE.fullmatch, rows[-1])):
        return None
    return LoggerHeader(list(rows[-3]), _units(rows[-2]), 3)


def _inca(rows: Rows, width: int) -> LoggerHeader | None:
    """Return the names, and the units that stand below what numbers they were."""
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
    """Return what Gulf Coast Data Concepts call columns; their times are seconds."""
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
