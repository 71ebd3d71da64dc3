"""Find the names and units of columns in the lines above the rows of a CSV file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from becalm.files.text.cells import GONE, NUMBER, kind_of, split
from becalm.files.text.logger_headers import logger_header
from becalm.files.unit_spelling import looks_like_unit, tidy_unit

_COMMENT = ("#", "%", "//")


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
    empty = all(kind == GONE for kind in kinds[len(cells) :])
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
    """Return whether a row of units is above a row of names, and the names are all different."""
    return len(upper) == len(names) == width == len(set(names)) and _are_units(upper) and not _are_units(names)


def _belong_together(upper: Sequence[str], lower: Sequence[str], at_top: bool) -> bool:
    """Return whether two rows together make the names, instead of a note above a row of names."""
    repeated = max(Counter(cell for cell in lower if cell).values(), default=0) > 1
    if repeated or any(kind_of(cell) == NUMBER for cell in upper):  # a note has numbers: "Sample rate, 100"
        return repeated
    return (at_top and all(upper[1:])) or (len(upper) > 2 and all(upper))


def _joined(upper: str, lower: str) -> str:
    return ".".join(part for part in (upper, lower) if part)


def _padded(cells: Sequence[str], width: int) -> list[str]:
    return [*cells[:width], *[""] * (width - len(cells))]
