"""Counters that wrapped and local time that fell back by an hour: undone where the evidence is clear.

A fall is mended only if every fall of the recording, once mended, is a step like the others; anything else
that goes backwards is left for the clock to refuse.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Booleans, Floats
from becalm.core.time.moments import Thinned

COUNTERS = (2.0**8, 2.0**16, 2.0**24, 2.0**31, 2.0**32)
"""Numbers at which counters start again from zero."""

HOUR_S = 3600.0
_ALIKE = (0.5, 1.5)  # of the median step: what a mended step may be
_SLOWEST_S = 900.0  # a step so long that an hour is only a few rows tells nothing
_SPRING = (3, 9, 10)  # months, north and south
_NIGHT_HOURS = (1, 2, 3, 4)  # after the leap
_SUNDAY = 3  # days since Thursday, 1970-01-01


class Steps:
    """What the steps of a time column are like, seen block by block.

    Parameters
    ----------
    count : int
        How many stamps will come.
    """

    def __init__(self, count: int) -> None:
        self._rises = Thinned(max(0, count - 1))
        self._last: float | None = None
        self._whole = True
        self._least, self._most = np.inf, -np.inf
        self._deepest, self._shallowest = 0.0, -np.inf
        self.falls = 0

    def add(self, stamps: Floats) -> None:
        """Look at the next stamps, (n,), in any unit."""
        steps = np.diff(stamps) if self._last is None else np.diff(stamps, prepend=self._last)
        self._last = float(stamps[-1])
        self._rises.add(steps)
        self._least, self._most = min(self._least, float(stamps.min())), max(self._most, float(stamps.max()))
        self._whole = self._whole and bool(np.all(stamps == np.round(stamps)))
        fallen = steps[steps < 0.0]
        if len(fallen):
            self.falls += len(fallen)
            self._deepest = min(self._deepest, float(fallen.min()))
            self._shallowest = max(self._shallowest, float(fallen.max()))

    @property
    def wraps_at(self) -> float | None:
        """The number at which this counter starts again from zero; None where it does not, or that is not clear."""
        if not self.falls or not self._whole or not self._least >= 0.0:  # NaN fails
            return None
        period = next((number for number in COUNTERS if number > self._most), None)
        return period if period is not None and self._mended_by(period) else None

    @property
    def falls_an_hour(self) -> bool:
        """Return whether all falls of stamps in seconds are those of an hour put back."""
        return bool(self.falls) and self._mended_by(HOUR_S)

    @property
    def median(self) -> float:
        """The median of the steps that rise; NaN where none does."""
        rises = self._rises.values
        rises = rises[rises > 0.0]
        return float(np.median(rises)) if len(rises) else np.nan

    def _mended_by(self, added: float) -> bool:
        low, high = (share * self.median for share in _ALIKE)
        return self._deepest + added >= low and self._shallowest + added <= high


def unwrapped(blocks: Iterable[NDArray[Any]], period: float) -> Iterator[NDArray[Any]]:
    """Undo the wraps of a counter.

    Parameters
    ----------
    blocks : iterable of (n,) arrays
        Ticks, float64 or int64.
    period : float
        The number at which the counter starts again from zero.

    Yields
    ------
    (n,) arrays
        Ticks of a counter that never wraps, of the same type.
    """
    last, turns = None, 0
    for ticks in blocks:
        before = ticks[0] if last is None else last
        passed = turns + np.cumsum(np.diff(ticks, prepend=before) < 0)
        yield ticks + passed.astype(ticks.dtype) * ticks.dtype.type(period)
        last, turns = ticks[-1], int(passed[-1])


class Hours(NamedTuple):
    """Stamps in local time, and how often the clock was put back and forth before them."""

    stamps_s: Floats  # (n,), as they would be had nobody touched the clock
    back: int
    forth: int


def one_clock(blocks: Iterable[Floats], first_s: float, step_s: float) -> Iterator[Hours]:
    """Undo hours put back and forth by daylight saving time.

    Parameters
    ----------
    blocks : iterable of (n,) arrays
        Stamps in seconds, all of whose falls are those of an hour put back.
    first_s : float
        What the stamp 0 is in local time, in seconds since 1970.
    step_s : float
        The usual step, in seconds.
    """
    last, back, forth = None, 0, 0
    for stamps in blocks:
        steps = np.diff(stamps, prepend=stamps[0] if last is None else last)
        fell = steps < 0.0
        leapt = np.zeros(len(stamps), np.int64)
        for row in np.flatnonzero(_alike(steps - HOUR_S, step_s)):
            leapt[row] = _put_forth(first_s + stamps[row] - steps[row], first_s + stamps[row])
        added = HOUR_S * (back - forth + np.cumsum(fell) - np.cumsum(leapt))
        back, forth = back + int(fell.sum()), forth + int(leapt.sum())
        last = stamps[-1]
        yield Hours(stamps + added, back, forth)


def _alike(steps: Floats, step_s: float) -> Booleans:
    return (steps >= _ALIKE[0] * step_s) & (steps <= _ALIKE[1] * step_s) & (step_s <= _SLOWEST_S)


def _put_forth(before_s: float, after_s: float) -> bool:
    """Return whether just the hour before a full one of a Sunday night in spring has no reading."""
    hour = np.floor(after_s / HOUR_S)
    day, of_day = divmod(int(hour), 24)
    month = np.datetime64(day, "D").astype("datetime64[M]").astype(int) % 12 + 1
    night = of_day in _NIGHT_HOURS and day % 7 == _SUNDAY and month in _SPRING
    return bool(night and np.ceil(before_s / HOUR_S) == hour - 1.0)
