"""Undo the wraps of counters and the changes to and from daylight saving time, where the evidence is clear.

Stamps are repaired only if the repair changes every backward step of the recording to a usual forward step. Otherwise
they stay as they are, and the clock raises an error.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Booleans, Floats
from becalm.core.time.clock import Thinned

COUNTERS = (2.0**8, 2.0**16, 2.0**24, 2.0**31, 2.0**32)
"""Periods of counters: after so many ticks a counter starts again from zero."""

HOUR_S = 3600.0
_ALIKE = (0.5, 1.5)  # range of a repaired step, over the median step
_SLOWEST_S = 900.0  # longest usual step for which a skipped hour can be recognised
_SPRING = (3, 9, 10)  # months in which clocks are put forward, on the northern and southern hemisphere
_NIGHT_HOURS = (1, 2, 3, 4)  # possible local hours right after the change
_SUNDAY = 3  # days from Thursday, 1970-01-01, to Sunday


class StepStatistics:
    """Statistics of the steps of a time column, added block by block.

    Parameters
    ----------
    count : int
        Number of stamps that will be added.
    """

    def __init__(self, count: int) -> None:
        self._rises = Thinned(max(0, count - 1))
        self._last: float | None = None
        self._whole = True
        self._least, self._most = np.inf, -np.inf
        self._deepest, self._shallowest = 0.0, -np.inf
        self.falls = 0

    def add(self, stamps: Floats) -> None:
        """Add the next stamps, (n,), in any unit."""
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
        """Return the period after which the stamps, as a counter, start again from zero; None if it is not clear."""
        if not self.falls or not self._whole or not self._least >= 0.0:  # NaN fails
            return None
        period = next((number for number in COUNTERS if number > self._most), None)
        return period if period is not None and self._repaired_by(period) else None

    @property
    def falls_by_hours(self) -> bool:
        """Return whether all backward steps, of stamps in seconds, come from clocks that were put back by an hour."""
        return bool(self.falls) and self._repaired_by(HOUR_S)

    @property
    def median(self) -> float:
        """Return the median of the forward steps; NaN if there are none."""
        rises = self._rises.values
        rises = rises[rises > 0.0]
        return float(np.median(rises)) if len(rises) else np.nan

    def _repaired_by(self, added: float) -> bool:
        low, high = (share * self.median for share in _ALIKE)
        return self._deepest + added >= low and self._shallowest + added <= high


def unwrap(blocks: Iterable[NDArray[Any]], period: float) -> Iterator[NDArray[Any]]:
    """Undo the wraps of a counter.

    Parameters
    ----------
    blocks : iterable of (n,) arrays
        Ticks, float64 or int64.
    period : float
        Number of ticks after which the counter starts again from zero.

    Yields
    ------
    (n,) arrays
        Ticks without wraps, of the same type.
    """
    last, turns = None, 0
    for ticks in blocks:
        before = ticks[0] if last is None else last
        passed = turns + np.cumsum(np.diff(ticks, prepend=before) < 0)
        yield ticks + passed.astype(ticks.dtype) * ticks.dtype.type(period)
        last, turns = ticks[-1], int(passed[-1])


class UnshiftedStamps(NamedTuple):
    """Stamps without the clock changes, and how often the clock was put back and forward so far."""

    stamps_s: Floats  # (n,) local time as if the clock had never been changed, in seconds
    back: int
    forth: int


def undo_clock_changes(blocks: Iterable[Floats], first_s: float, step_s: float) -> Iterator[UnshiftedStamps]:
    """Undo the hours by which daylight saving time puts the clock back and forward.

    Parameters
    ----------
    blocks : iterable of (n,) arrays
        Stamps in seconds, whose backward steps all come from clocks that were put back by an hour.
    first_s : float
        Local time of the stamp 0, in seconds since 1970.
    step_s : float
        The usual step, in seconds.

    Yields
    ------
    UnshiftedStamps
        The stamps of each block, as if the clock had not been changed.
    """
    last, back, forth = None, 0, 0
    for stamps in blocks:
        steps = np.diff(stamps, prepend=stamps[0] if last is None else last)
        put_back = steps < 0.0
        put_forward = np.zeros(len(stamps), np.int64)
        for row in np.flatnonzero(_are_usual(steps - HOUR_S, step_s)):
            put_forward[row] = _is_spring_change(first_s + stamps[row] - steps[row], first_s + stamps[row])
        added = HOUR_S * (back - forth + np.cumsum(put_back) - np.cumsum(put_forward))
        back, forth = back + int(put_back.sum()), forth + int(put_forward.sum())
        last = stamps[-1]
        yield UnshiftedStamps(stamps + added, back, forth)


def _are_usual(steps: Floats, step_s: float) -> Booleans:
    return (steps >= _ALIKE[0] * step_s) & (steps <= _ALIKE[1] * step_s) & (step_s <= _SLOWEST_S)


def _is_spring_change(before_s: float, after_s: float) -> bool:
    """Return whether the readings skip exactly the hour before a full hour of a Sunday night in spring."""
    hour = np.floor(after_s / HOUR_S)
    day, of_day = divmod(int(hour), 24)
    month = np.datetime64(day, "D").astype("datetime64[M]").astype(int) % 12 + 1
    night = of_day in _NIGHT_HOURS and day % 7 == _SUNDAY and month in _SPRING
    return bool(night and np.ceil(before_s / HOUR_S) == hour - 1.0)


# Decide whether the gaps between bursts of stamps come from lost rows or from a driver that waits.
#
# If rows are lost, the other stamps still have the even step of the sensor, and each gap is a whole number of steps. If
# a driver waits and then stamps all rows that it fetches, the gaps are independent of the steps within bursts.

_INSTANT = 0.5  # bursts shorter than this, over the mean step, count as one instant, even if their stamps are uneven
_EVEN = 0.2  # largest standard deviation of even steps within bursts, over their mean
_SIGMAS = 5.0  # least mean of cos(2 pi gap / step), in its standard deviations for random gaps
_PER_CYCLE = 8  # number of candidate steps per cycle of the cosine of a long gap
_MOST_GAPS, _MOST_CANDIDATES = 4096, 1000  # largest numbers of tested gaps, and of candidate steps


def rows_lost_between(steps: Floats, apart_s: float) -> bool:
    """Return whether the gaps between bursts may be lost rows of a sensor with an even step.

    Parameters
    ----------
    steps : (n,) float array
        Differences of consecutive stamps, in seconds.
    apart_s : float
        Steps longer than this are gaps between bursts.

    Returns
    -------
    bool
        True if the gaps are whole multiples of the even step within bursts, or if the stamps within bursts are neither
        even nor at one instant.
    """
    within, gaps = steps[steps <= apart_s], steps[steps > apart_s]
    middle = float(np.median(within)) if len(within) else 0.0
    if not middle > 0.0 or not len(gaps):
        return False  # there is no gap, or all stamps of a burst are at one instant
    near = within[np.abs(within - middle) <= 0.5 * middle]
    step, spread = float(near.mean()), float(near.std())
    if spread > _EVEN * step:
        return float(within.sum()) > _INSTANT * float(steps.mean()) * len(gaps)
    gaps = gaps[:: -(-len(gaps) // _MOST_GAPS)]
    error = 4.0 * spread / np.sqrt(len(near))
    cycles = 2.0 * error * float(np.quantile(gaps, 0.9)) / step**2
    candidates = step + error * np.linspace(-1.0, 1.0, int(np.clip(_PER_CYCLE * cycles, 1, _MOST_CANDIDATES)) | 1)
    wholeness = max(float(np.cos(2.0 * np.pi * gaps / one).mean()) for one in candidates)
    return bool(wholeness > _SIGMAS / np.sqrt(2.0 * len(gaps)))
