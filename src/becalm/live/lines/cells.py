"""What a cell of a line says: a number, nothing, an instant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Protocol

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.files.text.cells import MISSING, TIME, kind_of
from becalm.files.timing.times import EPOCHS, IMPLIED, PER_SECOND, SECONDS
from becalm.files.unit_spelling import parse_header

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


def numbers_of(cells: Sequence[bytes]) -> Floats:
    """Read many cells at once, several times as fast as one by one.

    Raises
    ------
    ValueError
        If one of them is no number, though it may be a missing reading.
    """
    read: Floats = pa.array(cells, pa.string()).cast(pa.float64()).to_numpy()  # Arrow's own error is a ValueError
    return read


class StampReader(Protocol):
    """Reads the cells of a time column."""

    def one(self, cell: Cell) -> float:
        """Return the seconds in a cell; ValueError if it holds no time."""
        ...

    def many(self, cells: Sequence[bytes]) -> Floats:
        """Return the seconds in each cell; ValueError if one holds no time."""
        ...


@dataclass(frozen=True)
class NumberStamps:
    """Stamps as numbers, of which so many seconds make `factor` / `per_second`."""

    factor: float = 1.0
    per_second: float = 1.0

    def one(self, cell: Cell) -> float:
        """Return the seconds in a cell; ValueError if it holds no time."""
        value = number_of(cell)
        if value is None or not math.isfinite(value):
            raise ValueError(cell)
        return value * self.factor / self.per_second

    def many(self, cells: Sequence[bytes]) -> Floats:
        """Return the seconds in each cell; ValueError if one holds no time."""
        read = numbers_of(cells)
        if not np.isfinite(read).all():
            raise ValueError(cells)
        return read * self.factor / self.per_second


class IsoStamps:
    """Stamps as ISO dates and times, which are UTC where they name no zone, in seconds since 1970."""

    def one(self, cell: Cell) -> float:
        """Return the seconds in a cell; ValueError if it holds no time."""
        if not isinstance(cell, str):
            raise ValueError(cell)
        told = datetime.fromisoformat(cell.strip().replace("/", "-"))
        try:
            return (told if told.tzinfo else told.replace(tzinfo=UTC)).timestamp()
        except OverflowError as cause:  # the first and the last day of the calendar, in another zone
            raise ValueError(cell) from cause

    def many(self, cells: Sequence[bytes]) -> Floats:
        """Return the seconds in each cell; ValueError if one holds no time."""
        return np.array([self.one(cell.decode()) for cell in cells])


def stamp_reader(name: str, unit: str, first: Cell) -> StampReader | None:
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
        return _number_stamps(name, unit, value) if math.isfinite(value) else None
    try:
        IsoStamps().one(first)
    except ValueError as cause:
        if isinstance(first, str) and kind_of(first) == TIME:
            raise UsageError(
                f"The times in column {name!r} have no ISO date ({first.strip()!r}); name another column with"
                " ?time=COLUMN, or stamp rows when they come with ?time=arrival."
            ) from cause
        return None
    return IsoStamps()


def _number_stamps(name: str, unit: str, first: float) -> NumberStamps:
    bare, own = parse_header(name)
    unit = unit or own or IMPLIED.get(bare.lower(), "")
    if unit in SECONDS:
        return NumberStamps(factor=SECONDS[unit])
    if unit not in PER_SECOND:
        unit = next((name for name, low, high in EPOCHS if low <= first <= high), "s")
    return NumberStamps(per_second=PER_SECOND[unit])


def place_named(name: str, names: Sequence[str]) -> int | None:
    """Return where a column stands that is named as it is, or without its unit; None where there is none, or two."""
    if name in names:
        return names.index(name)
    alike = [place for place, own in enumerate(names) if parse_header(own)[0] == name]
    return alike[0] if len(alike) == 1 else None
