"""What stands above the rows of loggers that write a head of their own kind: LabVIEW's LVM, Campbell's TOA5."""

from __future__ import annotations

from collections.abc import Sequence

from becalm.files.units import tidy_unit

_STATION, _LABVIEW = "TOA5", "LabVIEW Measurement"
_CAMPBELL_ROWS = 4  # the station, names, units, and what was stored of each
_NO_UNITS = ("TS", "RN")  # a stamp, and the number of the record
_COMMENT = "Comment"  # a name above cells that rows without a comment leave out


def logger_header(rows: Sequence[Sequence[str]], width: int) -> tuple[list[str], list[str], int] | None:
    """Return the names, the units and how many rows hold them, None if no such logger wrote this.

    Parameters
    ----------
    rows : sequence of sequence of str
        The cells of all lines above the data that are not blank.
    width : int
        Columns of the table.
    """
    if rows[0][0] == _STATION and len(rows) == _CAMPBELL_ROWS:
        return list(rows[1]), ["" if cell in _NO_UNITS else tidy_unit(cell) for cell in rows[2]], 2
    if rows[0][0] != _LABVIEW:
        return None
    told = {row[0]: row[1:] for row in rows}
    names = list(rows[-1])
    if len(names) == width + 1 and names[-1] == _COMMENT:
        names.pop()
    units = [tidy_unit(cell) for cell in told.get("Y_Unit_Label", ())]
    first = "s" if "Time" in told.get("X_Dimension", ()) else ""
    return names, ([first, *units] if len(units) + 1 >= width else []), 1
