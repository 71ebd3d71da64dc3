"""Parse the cells of lines: numbers, missing values and time stamps."""

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
from becalm.files.timing.times import EPOCHS, PER_SECOND, SECONDS
from becalm.files.units.unit_spelling import TIME_UNITS, parse_header, time_unit

Cell = object
"""Text of CSV, or a value of JSON: a float, None, text or anything else."""

_MISSING = frozenset(MISSING)


def number_of(cell: Cell) -> float | None:
    """Return the number in a cell, NaN for a missing reading, None if it is not a number."""
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
        return None if "_" in text else float(text)  # instruments do not write 1_000
    except ValueError:
        return None


def numbers_of(cells: Sequence[bytes]) -> Floats:
    """Parse many cells at once, several times faster than one by one.

    Raises
    ------
    ValueError
        If a cell is not a number; it may still be a missing reading.
    """
    numbers: Floats = pa.array(cells, pa.string()).cast(pa.float64()).to_numpy()  # Arrow's error is a ValueError
    return numbers


class StampReader(Protocol):
    """A parser of the cells of a time column."""

    def parse(self, cell: Cell) -> float:
        """Return the stamp in a cell, in seconds; raise a ValueError if it has none."""
        ...

    def parse_many(self, cells: Sequence[bytes]) -> Floats:
        """Return the stamps in cells, in seconds; raise a ValueError if a cell has none."""
        ...


@dataclass(frozen=True)
class NumberStamps:
    """A parser of numeric stamps; seconds are number * `factor` / `per_second`."""

    factor: float = 1.0
    per_second: float = 1.0

    def parse(self, cell: Cell) -> float:
        """Return the stamp in a cell, in seconds; raise a ValueError if it has none."""
        value = number_of(cell)
        if value is None or not math.isfinite(value):
            raise ValueError(cell)
        return value * self.factor / self.per_second

    def parse_many(self, cells: Sequence[bytes]) -> Floats:
        """Return the stamps in cells, in seconds; raise a ValueError if a cell has none."""
        numbers = numbers_of(cells)
        if not np.isfinite(numbers).all():
            raise ValueError(cells)
        return numbers * self.factor / self.per_second


class IsoStamps:
    """A parser of ISO dates and times into seconds since 1970; without a time zone they are UTC."""

    def parse(self, cell: Cell) -> float:
        """Return the stamp in a cell, in seconds; raise a ValueError if it has none."""
        if not isinstance(cell, str):
            raise ValueError(cell)
        date = datetime.fromisoformat(cell.strip().replace("/", "-"))
        try:
            return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
        except OverflowError as cause:  # the first or last day of the calendar, in another time zone
            raise ValueError(cell) from cause

    def parse_many(self, cells: Sequence[bytes]) -> Floats:
        """Return the stamps in cells, in seconds; raise a ValueError if a cell has none."""
        return np.array([self.parse(cell.decode()) for cell in cells])


def stamp_reader(name: str, unit: str, first: Cell) -> StampReader | None:
    """Return the parser of a time column from its name, its unit and its first cell; None if that cell has no stamp.

    Numbers are seconds, unless the unit, the name or the size of the first number indicates another unit: 1.7e12 is
    in milliseconds since 1970.

    Raises
    ------
    UsageError
        If the cell is a time without a date, or the unit is not one of time.
    """
    value = number_of(first)
    if value is not None:
        return _number_stamps(name, unit, value) if math.isfinite(value) else None
    try:
        IsoStamps().parse(first)
    except ValueError as cause:
        if isinstance(first, str) and kind_of(first) == TIME:
            raise UsageError(
                f"The times in column {name!r} have no ISO date ({first.strip()!r}); choose another column with"
                " ?time=COLUMN, or stamp rows when they arrive with ?time=arrival."
            ) from cause
        return None
    return IsoStamps()


def _number_stamps(name: str, unit: str, first: float) -> NumberStamps:
    unit = time_unit(name, unit)
    if unit not in ("", *TIME_UNITS.values()):
        raise UsageError(
            f"The times in column {name!r} have the unit {unit!r}, which is not one of time; choose another column with"
            " ?time=COLUMN, or stamp rows when they arrive with ?time=arrival."
        )
    if unit in SECONDS:
        return NumberStamps(factor=SECONDS[unit])
    if unit not in PER_SECOND:
        unit = next((name for name, low, high in EPOCHS if low <= first <= high), "s")
    return NumberStamps(per_second=PER_SECOND[unit])


def place_named(name: str, names: Sequence[str]) -> int | None:
    """Return the index of the column with this name, with or without a unit on one side; None if not exactly one."""
    if name in names:
        return names.index(name)
    bare, unit = parse_header(name)
    headers = [parse_header(column) for column in names]
    matches = [at for at, (own, its_unit) in enumerate(headers) if own in (name, bare) and not (unit and its_unit)]
    return matches[0] if len(matches) == 1 else None
