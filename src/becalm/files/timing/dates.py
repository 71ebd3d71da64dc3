"""Read dates, and find the order of day, month and year in them."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Booleans, Integers
from becalm.errors import TimeError

YEAR_FIRST, DAY_FIRST, MONTH_FIRST, MIXED = "year first", "day first", "month first", "mixed"  # orders of dates
SHORT_YEAR_FIRST = "year of two digits first"
_ORDERS = (DAY_FIRST, MONTH_FIRST, SHORT_YEAR_FIRST)  # those of numbers without a first year of four digits
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


def field_of(parts: pa.Array, name: str) -> pa.Array:
    """Return one part of each cell as text, "" where there is none."""
    return pc.fill_null(pc.struct_field(parts, name), "")


def whole_numbers(text: pa.Array, empty: int = 0) -> Integers:
    """Convert text to whole numbers; an empty text becomes `empty`."""
    filled = pc.if_else(pc.equal(text, ""), str(empty), text)
    return np.asarray(filled.cast(pa.int64()))


class Dates:
    """The evidence in all dates of a column on the order of day, month and year."""

    def __init__(self) -> None:
        self._named = False  # whether months are written as names
        self._first_years = self._last_years = False  # whether years of four digits come first, or not
        self._halves = False  # whether AM or PM is written
        self._short = True  # whether the first and the last number have two digits
        self._mark = ""
        self._readings = {order: _Reading() for order in _ORDERS}

    def add(self, parts: pa.Array, missing: Booleans) -> None:
        """Examine the next dates."""
        present = ~missing & ~np.asarray(pc.is_null(parts))
        lengths = [np.asarray(pc.utf8_length(field_of(parts, part)))[present] for part in "ac"]
        self._mark = self._mark or next((mark for mark in field_of(parts, "mark").to_pylist() if mark), "")
        self._halves = self._halves or bool(pc.any(pc.not_equal(field_of(parts, "half"), "")).as_py())
        self._named = self._named or _month_numbers(field_of(parts, "b"))[1]
        self._first_years = self._first_years or bool((lengths[0] == 4).any())
        self._last_years = self._last_years or not (lengths[0] == 4).all()
        self._short = self._short and all(bool((length == 2).all()) for length in lengths)
        if not present.any() or self._first_years:
            return
        for order, reading in self._readings.items():
            days, wrong = days_of(parts, present, order)
            reading.add(days[present], wrong[present])

    def order(self, name: str) -> tuple[str, str, bool]:
        """Return the order of day, month and year, a note for the user, and whether the order is known.

        Where several orders are possible, the one is taken in which each date is that of the row before or the next
        day. If all dates are equal, the order changes no step, but the first instant.

        Raises
        ------
        TimeError
            If several orders are possible and give different steps between rows.
        """
        if self._first_years:
            return MIXED if self._last_years else YEAR_FIRST, "", True
        possible = {
            order: reading
            for order, reading in self._readings.items()
            if not reading.wrong and (self._short or order != SHORT_YEAR_FIRST)
        }
        if self._named or not possible or (self._mark == "." and DAY_FIRST in possible):
            return DAY_FIRST, "", True
        usual = [order for order, reading in possible.items() if reading.usual]
        same = all(reading.stays for reading in possible.values())
        if len(possible) == 1 or (same and len({reading.first for reading in possible.values()}) == 1):
            return next(iter(possible)), "", True
        read = f"The dates in {name!r} can be read {' or '.join(possible)}"
        if same and self._halves and MONTH_FIRST in possible:
            return MONTH_FIRST, f"{read}; they are read month first, because AM or PM is written. {_AS_ISO}", True
        if same:
            return next(iter(possible)), f"{read}, so the day of the first row is not known. {_AS_ISO}", False
        if len(usual) == 1:
            return usual[0], "", True
        raise TimeError(
            f"{read}, and these differ. "
            "Write them as YYYY-MM-DD, name another column with --time, or count rows with --rate HZ."
        )


_AS_ISO = "Write them as YYYY-MM-DD to be sure."


class _Reading:
    """What the dates of a column are if read in one order.

    Attributes
    ----------
    wrong : bool
        Whether a date does not exist.
    stays : bool
        Whether all dates are equal.
    usual : bool
        Whether each date is that of the row before or a day beside it, and some are that of the row before.
    """

    def __init__(self) -> None:
        self.wrong, self.stays = False, True
        self.first: int | None = None
        self._last = 0
        self._near, self._repeats = True, False

    @property
    def usual(self) -> bool:
        return self._near and self._repeats

    def add(self, days: Integers, wrong: Booleans) -> None:
        """Add the next dates, at least one, as days since 1970, and a mask of those that do not exist."""
        self.wrong = self.wrong or bool(wrong.any())
        steps = np.diff(days) if self.first is None else np.diff(days, prepend=self._last)
        self.first = int(days[0]) if self.first is None else self.first
        self._last = int(days[-1])
        self.stays = self.stays and not steps.any()
        self._near = self._near and bool(np.all(np.abs(steps) <= 1))
        self._repeats = self._repeats or bool(np.any(steps == 0))


def days_of(parts: pa.Array, present: Booleans, order: str) -> tuple[Integers, Booleans]:
    """Return days since 1970, and a mask of dates that do not exist; a mixed order marks those with the year first."""
    first, last = field_of(parts, "a"), field_of(parts, "c")
    if not present.any():
        return np.zeros(len(first), np.int64), ~present
    if order == MIXED:
        return np.zeros(len(first), np.int64), np.asarray(pc.utf8_length(first)) == 4
    a, b, c = whole_numbers(first), whole_numbers(_month_numbers(field_of(parts, "b"))[0]), whole_numbers(last)
    if order == YEAR_FIRST:
        return _civil(a, b, c)
    if order == SHORT_YEAR_FIRST:
        a, c = c, a
    c = np.where(c < 69, c + 2000, np.where(c < 100, c + 1900, c))  # as POSIX reads two digits
    if order == SHORT_YEAR_FIRST:
        return _civil(c, b, a)
    return _civil(c, b, a) if order == DAY_FIRST else _civil(c, a, b)


def _month_numbers(middle: pa.Array) -> tuple[pa.Array, bool]:
    """Return months as digits, 0 for an unknown name, and whether there are names."""
    lower = pc.utf8_lower(middle)
    if not pc.any(pc.match_substring_regex(lower, "[a-z]")).as_py():
        return middle, False
    for number, month in enumerate(_MONTHS, start=1):
        lower = pc.if_else(pc.equal(lower, month), str(number), lower)
    is_number = pc.match_substring_regex(lower, "^[0-9]*$")
    return pc.if_else(is_number, lower, "0"), True


def _civil(year: Integers, month: Integers, day: Integers) -> tuple[Integers, Booleans]:
    """Return days since 1970 of calendar dates, and a mask of dates that do not exist."""
    wrong = (month < 1) | (month > 12) | (day < 1) | (day > 31) | (year < 1700) | (year > 2200)
    safe_year, safe_month = np.where(wrong, 1970, year), np.where(wrong, 1, month)
    months = (safe_year - 1970).astype("datetime64[Y]").astype("datetime64[M]") + (safe_month - 1)
    dates = months.astype("datetime64[D]") + (np.where(wrong, 1, day) - 1)
    wrong |= dates.astype("datetime64[M]") != months
    return dates.astype(np.int64), wrong
