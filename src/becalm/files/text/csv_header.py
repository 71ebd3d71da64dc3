"""Find the names and units of columns in the lines above the rows of a CSV file."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from becalm.files.text.cells import MISSING_CELL, NUMBER, kind_of, split
from becalm.files.units.unit_spelling import looks_like_unit, tidy_unit

# Read the special headers that some loggers and oscilloscopes write above the rows.

_STATION, _LABVIEW = "TOA5", "LabVIEW Measurement"  # first cells of the headers of Campbell and LabVIEW
_X = "X_Value"  # LabVIEW's name of the time
_CAMPBELL_ROWS = 4  # the station, names, units, and how each value was processed
_NO_UNITS = ("TS", "RN", "Sequence", "unix time")  # texts in a row of units that are not units
_COMMENT_NAME = "Comment"  # the name of LabVIEW's last column; a row without a comment has no cell for it
_DEVICE = re.compile(r"calc|[0-9]+: ?\w+")  # a cell of RaceChrono's third header row: the source of a channel
_STEP = re.compile(r"t(?:0|Inc)\s*=.*")  # a start or step in Rigol's row of names; the rows have no cell for it

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


_COMMENT = ("#", "%", "//")  # how a comment begins


@dataclass(frozen=True)
class Header:
    """The header of a table.

    Attributes
    ----------
    names : tuple of str
        A name for each column, "" if the file gives none.
    units : tuple of str
        A unit for each column from a row of units, "" if the file gives none.
    rows : int
        Number of rows of names and units.
    skipped : int
        Number of other lines above the data that are not blank.
    given : int
        Number of cells in the row of names; 0 if there is no header.
    fits : bool
        Whether there is one name per column; empty columns at the right need no name.
    rate_hz : float, optional
        The sample rate in Hz, if the lines above the data give it.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: int
    skipped: int
    given: int
    fits: bool = True
    rate_hz: float | None = None


def find_header(above: Sequence[str], start: int, separator: str, kinds: tuple[str, ...]) -> Header:
    """Find names and units in the lines above the data.

    Parameters
    ----------
    above : sequence of str
        All lines above the first row of data.
    start : int
        Number of lines at the top that are not part of the header (`sep=;`).
    separator : str
        The separator between two cells.
    kinds : tuple of str
        The kind of each column.
    """
    width = len(kinds)
    filled = [number for number in range(start, len(above)) if above[number].strip()]
    plain = [number for number in filled if not above[number].strip().startswith(_COMMENT)]
    rows = [_with_blank_names(_cells(above[number], separator, width), kinds) for number in plain]
    if not rows or (width > 1 and len(rows[-1]) < 2 and rows[-1] != [""]):
        rows = _names_in_comment(above, filled, separator, width)
    if not rows:
        return Header(("",) * width, ("",) * width, 0, len(filled) + start, 0)
    if logger := logger_header([_cells(above[number], separator, width) for number in plain] or rows, width):
        return _header(logger.names, logger.units, logger.used, (len(filled) + start, width))
    together = next((back for back in range(1, len(plain)) if plain[-back] - plain[-back - 1] > 1), len(plain))
    return _read(rows, kinds, len(filled) + start, together)


def unique_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return unique names: `column_3` for a column without a name, `x_2` for a second `x`."""
    taken = set(names)
    used: set[str] = set()
    out = []
    for number, name in enumerate(names, start=1):
        own = name or f"column_{number}"
        base, copy = own, 1
        while own in used or (own != name and own in taken):
            copy += 1
            own = f"{base}_{copy}"
        used.add(own)
        out.append(own)
    return tuple(out)


def _read(rows: list[list[str]], kinds: tuple[str, ...], lines: int, together: int) -> Header:
    """Find names and units in rows of cells, of which the last `together` have no blank line between them."""
    width = len(kinds)
    units: list[str] = []
    used = 1
    if len(rows) > 1 and _are_units(rows[-1]) and len(rows[-1]) == len(rows[-2]) == width:
        units = [tidy_unit(cell) for cell in rows.pop()]
        used += 1
    elif len(rows) > 1 and _are_units_above(rows[-2], rows[-1], width):
        units = [tidy_unit(cell) for cell in rows.pop(-2)]
        used += 1
    names = rows[-1]
    maybe_two_rows = together > used and len(rows) > 1 and len(rows[-2]) == len(names) == width
    if maybe_two_rows and _belong_together(rows[-2], names, len(rows) == 2):
        names = [_joined(upper, lower) for upper, lower in zip(rows[-2], names, strict=True)]
        used += 1
    return _header(names, units, used, (lines, width))


def _header(names: Sequence[str], units: Sequence[str], used: int, size: tuple[int, int]) -> Header:
    """Return a header; `size` is the number of lines above the table that are not blank, and the number of columns."""
    lines, width = size
    padded = tuple(_padded(names, width)), tuple(_padded(units, width))
    return Header(*padded, used, lines - used, len(names), len(names) == width)


def _cells(line: str, separator: str, width: int) -> list[str]:
    cells = [cell.strip() for cell in split(line, separator)]
    while len(cells) > width and not cells[-1]:
        cells.pop()
    return cells


def _with_blank_names(cells: list[str], kinds: Sequence[str]) -> list[str]:
    """Add blank names for empty columns at the right, which trailing separators create."""
    empty = all(kind == MISSING_CELL for kind in kinds[len(cells) :])
    return _padded(cells, len(kinds)) if len(cells) > 1 and empty else cells


def _names_in_comment(above: Sequence[str], filled: Sequence[int], separator: str, width: int) -> list[list[str]]:
    """Return the names in a comment right above the data, as numpy writes them after a `#`."""
    if not filled:
        return []
    last = above[filled[-1]].strip()
    if not last.startswith(_COMMENT):
        return []
    cells = _cells(last.lstrip("#%/").strip(), separator, width)
    named = len(cells) == width or (len(cells) == width + 1 and cells[0] == "Headers")
    return [cells] if named and not any(kind_of(cell) == NUMBER for cell in cells) else []


def _are_units(row: Sequence[str]) -> bool:
    filled = [cell for cell in row if cell]
    return bool(filled) and any(cell not in ("-", "--") for cell in filled) and all(map(looks_like_unit, filled))


def _are_units_above(upper: Sequence[str], names: Sequence[str], width: int) -> bool:
    """Return whether `upper` is a row of units above a row of names, and the names are all different."""
    return len(upper) == len(names) == width == len(set(names)) and _are_units(upper) and not _are_units(names)


def _belong_together(upper: Sequence[str], lower: Sequence[str], at_top: bool) -> bool:
    """Return whether two rows together hold the names; otherwise, the upper row is a note above the names."""
    repeated = max(Counter(cell for cell in lower if cell).values(), default=0) > 1
    if repeated or any(kind_of(cell) == NUMBER for cell in upper):  # a note has numbers: "Sample rate, 100"
        return repeated
    return (at_top and all(upper[1:])) or (len(upper) > 2 and all(upper))


def _joined(upper: str, lower: str) -> str:
    return ".".join(part for part in (upper, lower) if part)


def _padded(cells: Sequence[str], width: int) -> list[str]:
    return [*cells[:width], *[""] * (width - len(cells))]
