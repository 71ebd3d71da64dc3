"""What a cell of a line says: a number, nothing, an instant."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

from becalm.errors import UsageError
from becalm.files.text.cells import MISSING, TIME, kind_of
from becalm.files.timing.times import EPOCHS, IMPLIED, PER_SECOND, SECONDS
from becalm.files.units import parse_header

Cell = object
"""Text of CSV, or a value of JSON: a float, None, text or anything else."""

_MISSING = frozenset(MISSING)


def number_of(cell: Cell) -> float | None:
    """Return what a cell holds, NaN where it says that nothing was read, None where it is no number."""
    if isinstance(cell, float):
        return cell
    if cell is None:
        return math.nan
    if not isinstance(cell, str):
        return None
    text = cell.strip()
    if text in _MISSING:
        return math.nan
    try:
        return None if "_" in text else float(text)  # Python's own 1_000 is no number of an instrument
    except ValueError:
        return None


def instant_of(cell: Cell) -> float:
    """Read an ISO date and time, which is UTC where it names no zone, as seconds since 1970.

    Raises
    ------
    ValueError
        If it is none.
    """
    text = cell.decode() if isinstance(cell, bytes) else str(cell)
    told = datetime.fromisoformat(text.strip().replace("/", "-"))
    try:
        return (told if told.tzinfo else told.replace(tzinfo=UTC)).timestamp()
    except OverflowError as cause:  # the first and the last day of the calendar, in another zone
        raise ValueError(text) from cause


def stamp_reader(name: str, unit: str, first: Cell) -> Callable[[Cell], float] | None:
    """Return what reads the cells of a time column, by its name, its unit and its first cell; None if that is empty.

    Numbers are seconds, unless the unit, the name or the size of the first says otherwise: 1.7e12 counts milliseconds
    since 1970.

    Raises
    ------
    UsageError
        If the cell is a time without a date.
    """
    value = number_of(first)
    if value is not None:
        return _number_reader(name, unit, value) if math.isfinite(value) else None
    try:
        instant_of(first)
    except ValueError as cause:
        if isinstance(first, str) and kind_of(first) == TIME:
            raise UsageError(
                f"The times in column {name!r} have no ISO date ({first.strip()!r}); name another column with"
                " ?time=COLUMN, or stamp rows when they come with ?time=arrival."
            ) from cause
        return None
    return instant_of


def _number_reader(name: str, unit: str, first: float) -> Callable[[Cell], float]:
    bare, own = parse_header(name)
    unit = unit or own or IMPLIED.get(bare.lower(), "")
    if unit in SECONDS:
        factor = SECONDS[unit]
        return lambda cell: _finite(cell) * factor
    if unit not in PER_SECOND:
        unit = next((name for name, low, high in EPOCHS if low <= first <= high), "s")
    per_second = PER_SECOND[unit]
    return lambda cell: _finite(cell) / per_second


def _finite(cell: Cell) -> float:
    value = float(cell) if isinstance(cell, bytes) else number_of(cell)
    if value is None or not math.isfinite(value):
        raise ValueError(cell)
    return value


def place_named(name: str, names: Sequence[str]) -> int | None:
    """Return where a column stands that is named as it is, or without its unit; None where there is none, or two."""
    if name in names:
        return names.index(name)
    alike = [place for place, own in enumerate(names) if parse_header(own)[0] == name]
    return alike[0] if len(alike) == 1 else None
