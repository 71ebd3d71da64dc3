"""Find the even grid of the sampling times from stamps that a driver disturbed.

Two disturbances can be recognised. *Jitter*: every stamp lies near a straight line over the row number, and the errors
of neighbouring stamps are independent. *Bursts*: a driver fetches several samples at once and stamps them at nearly one
instant, after all of them were taken. The line is then a lower bound of the first stamps of bursts. The skew of a clock
is estimated in the same way from delays that are never negative (Moon, Skelly and Towsley, 1999).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.time.clock import Blocks, Moments, Thinned, last_digit
from becalm.core.time.repair import rows_lost_between

JITTER, BURSTS = "jitter", "bursts"

FEWEST_ROWS = 100
"""Smallest number of stamps for which a grid is searched."""

_LEAST_JITTER, _MOST_JITTER = 0.02, 0.15  # std in steps: with less, stamps are used; with more, sampling may be uneven
_FARTHEST = 0.45  # largest error of a stamp, in steps; an error of half a step could be a lost row
_LAGS = 16  # largest lag, in rows, up to which jitter must be uncorrelated
_CORRELATED = 0.1  # largest correlation of jitter, or four standard deviations of chance if these are larger
_APART = 0.4  # largest difference of consecutive stamps of a burst, in steps
_LATEST = 1.1  # largest delay of a burst, in steps: a driver waits up to one step for a sample; with a margin
_PARTS, _TOUCHING = 8, 0.25  # no row is lost if each of 8 parts has a burst this close to the line, in steps
_FEWEST_BURSTS = 128  # least number of bursts
_SEVERAL = 1.5  # least mean number of rows per burst
_SIZES = 65  # a burst must have fewer rows
_UNLIKE = 0.05  # least share of bursts of other sizes; with fewer, sampling in bursts is possible
_COARSE = 0.75  # stamps are too coarse if their last digit is at least this, over the mean time between bursts
_SEGMENTS = 64  # number of segments of a block's bursts; one burst of each segment is kept


class Grid(NamedTuple):
    """An even grid of samples.

    Attributes
    ----------
    kind : str
        "jitter" or "bursts".
    start_s, step_s : float
        Time of the first sample and sampling interval, in seconds.
    jitter_s : float
        Standard deviation of the delays of the stamps relative to the grid, in seconds.
    """

    kind: str
    start_s: float
    step_s: float
    jitter_s: float


def even_grid(count: int, blocks: Blocks) -> Grid | None:
    """Find the even grid of stamps without lost rows, in three passes over the stamps and constant memory.

    Parameters
    ----------
    count : int
        Number of stamps.
    blocks : callable
        Returns an iterator over the stamps in seconds, in (n,) blocks; it is called for each pass.

    Returns
    -------
    Grid or None
        The grid; None if the stamps show no grid or are not valid times.
    """
    ends = _ends(blocks) if count >= FEWEST_ROWS else None
    if ends is None:
        return None
    first, mean_s = ends[0], (ends[1] - ends[0]) / (count - 1)
    sums, bursts = Moments(), _Bursts(first, mean_s)
    for rows, offsets in _offsets(blocks, first, mean_s):
        sums.add(rows, offsets)
        bursts.add(rows, offsets + mean_s * rows)
    slope = sums.product / sums.scatter
    line = _Line(mean_s + slope, first + sums.other - slope * sums.mean)
    return _burst_grid(count, blocks, bursts) if bursts.from_driver else _jitter_grid(blocks, line)


class EqualBursts(NamedTuple):
    """Bursts of one size: the stamps alone do not show whether a driver or the sampling made them."""

    rows: int  # number of rows in each burst
    rate_hz: float  # mean rate of the rows, in hertz


def equal_bursts(count: int, blocks: Blocks) -> EqualBursts | None:
    """Find bursts of one size and the mean rate of their rows; return None if the stamps have no such bursts.

    Parameters
    ----------
    count : int
        Number of stamps.
    blocks : callable
        Returns an iterator over the stamps in seconds, in (n,) blocks; it is called for each pass.
    """
    ends = _ends(blocks) if count >= FEWEST_ROWS else None
    if ends is None:
        return None
    mean_s = (ends[1] - ends[0]) / (count - 1)
    bursts = _Bursts(ends[0], mean_s)
    for rows, offsets in _offsets(blocks, ends[0], mean_s):
        bursts.add(rows, offsets + mean_s * rows)
    return bursts.equal


def _ends(blocks: Blocks) -> tuple[float, float] | None:
    """Return the first and the last stamp; None if a stamp is missing, time decreases, or all stamps are equal."""
    first = last = None
    for stamps in blocks():
        first = float(stamps[0]) if first is None else first
        if not np.diff(stamps, prepend=first if last is None else last).min() >= 0.0:  # NaN fails
            return None
        last = float(stamps[-1])
    return None if first is None or last is None or first == last else (first, last)


class _Line(NamedTuple):
    step: float  # in seconds
    start: float  # time of row 0, in seconds


def _offsets(blocks: Blocks, start: float, step: float) -> Iterator[tuple[Floats, Floats]]:
    """Yield row numbers (n,), and the delays of their stamps relative to a line, in seconds."""
    row = 0
    for stamps in blocks():
        rows = np.arange(row, row + len(stamps), dtype=np.float64)
        yield rows, (stamps - start) - step * rows
        row += len(stamps)


def _jitter_grid(blocks: Blocks, line: _Line) -> Grid | None:
    """Return the grid of a fitted line if the distances of the stamps from it are jitter; otherwise None."""
    deviations, products, farthest = Moments(), np.zeros(_LAGS + 1), 0.0
    tail = np.empty(0)
    for _, offsets in _offsets(blocks, line.start, line.step):
        farthest = max(farthest, float(np.abs(offsets).max()))
        if not farthest <= _FARTHEST * line.step:
            return None
        deviations.add(offsets)
        joined = np.concatenate([tail, offsets])
        for lag in range(min(_LAGS + 1, len(joined))):
            products[lag] += float(joined[max(0, len(tail) - lag) : len(joined) - lag] @ joined[max(len(tail), lag) :])
        tail = joined[-_LAGS:]
    white = max(_CORRELATED, 4.0 / np.sqrt(deviations.count)) * products[0]
    fits = _LEAST_JITTER * line.step <= deviations.std <= _MOST_JITTER * line.step
    if not fits or not np.all(np.abs(products[1:]) <= white):
        return None
    return Grid(JITTER, line.start, line.step, deviations.std)


class _Bursts:
    """A splitter of stamps into bursts; it describes a burst by its first stamp and its last row.

    For the line below all bursts, it keeps from each segment of a block the burst with the least delay.
    """

    def __init__(self, first: float, mean: float) -> None:
        self._first, self.mean = first, mean
        self._open: float | None = None  # first stamp of the burst that may continue
        self._before = -np.inf
        self._rows: list[float] = []  # last rows of the kept bursts
        self._stamps: list[float] = []  # their first stamps
        self._sizes = np.zeros(_SIZES + 1, np.int64)  # number of bursts of each size
        self._ended = -1.0  # last row of the last complete burst
        self.count = 0  # number of complete bursts

    def add(self, rows: Floats, stamps: Floats) -> None:
        """Add the next rows, (n,), and their stamps relative to the first stamp."""
        self._keep_least_delayed(*self.split(rows, stamps))

    def split(self, rows: Floats, stamps: Floats) -> tuple[Floats, Floats]:
        """Return the last row and the first stamp of each burst that ended; the last burst may continue."""
        begins = np.flatnonzero(np.diff(stamps, prepend=self._before) > _APART * self.mean)
        self._before = float(stamps[-1])
        ends, firsts = rows[begins] - 1.0, stamps[begins]
        if self._open is None:
            ends, closed = ends[1:], firsts[:-1]
        else:
            closed = np.concatenate([[self._open], firsts])[: len(ends)]
        self._open = float(firsts[-1]) if len(begins) else self._open
        return ends, closed

    def _keep_least_delayed(self, ends: Floats, firsts: Floats) -> None:
        if not len(ends):
            return
        sizes = np.diff(ends, prepend=self._ended).astype(np.int64)
        self._sizes += np.bincount(np.minimum(sizes, _SIZES), minlength=_SIZES + 1)
        self._ended = float(ends[-1])
        self.count += len(ends)
        late = firsts - self.mean * ends
        for part in np.array_split(np.arange(len(ends)), min(_SEGMENTS, len(ends))):
            least = part[np.argmin(late[part])]
            self._rows.append(float(ends[least]))
            self._stamps.append(float(firsts[least]))

    @property
    def from_driver(self) -> bool:
        """Return whether a driver made the bursts: their sizes differ. Equal bursts may come from the sampling."""
        rows = self._ended + 1.0
        if self.count < _FEWEST_BURSTS or self._sizes[_SIZES] or rows < _SEVERAL * self.count:
            return False
        if last_digit(np.array(self._stamps)) >= _COARSE * self.mean * rows / self.count:
            return False  # truncated stamps, e.g. to whole seconds, are earlier than their samples
        return self.count - int(self._sizes.max()) >= _UNLIKE * self.count

    @property
    def equal(self) -> EqualBursts | None:
        """Return size and rate of the bursts if nearly all bursts have the same size; otherwise None."""
        size = int(np.argmax(self._sizes))
        unlike = self.count - int(self._sizes[size])
        if self.count < _FEWEST_BURSTS or not 1 < size < _SIZES or unlike >= _UNLIKE * self.count or not self._open:
            return None
        return EqualBursts(size, float(f"{(self._ended + 1.0) / self._open:.6g}"))

    def line_below(self) -> _Line:
        """Return the closest line below all first stamps, which is the middle edge of their lower convex hull."""
        rows, stamps = np.array(self._rows), np.array(self._stamps)
        hull = _lower_hull(rows, stamps)
        edge = int(np.clip(np.searchsorted(rows[hull], rows.mean()), 1, len(hull) - 1))
        left, right = hull[edge - 1], hull[edge]
        step = float((stamps[right] - stamps[left]) / (rows[right] - rows[left]))
        return _Line(step, self._first + float(stamps[left] - step * rows[left]))


def _lower_hull(x: Floats, y: Floats) -> Integers:
    """Return the indices of the lower convex hull for increasing x (Andrew's monotone chain)."""
    hull: list[int] = []
    for point in range(len(x)):
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            if (x[b] - x[a]) * (y[point] - y[a]) > (y[b] - y[a]) * (x[point] - x[a]):
                break
            hull.pop()
        hull.append(point)
    return np.array(hull)


def _burst_grid(count: int, blocks: Blocks, bursts: _Bursts) -> Grid | None:
    """Return the grid below the bursts if no burst is too late and no row is lost; otherwise None."""
    line = bursts.line_below()
    deviations, splitter, least = Moments(), _Bursts(0.0, bursts.mean), np.full(_PARTS, np.inf)
    steps, before = Thinned(count), 0.0
    for rows, offsets in _offsets(blocks, line.start, line.step):
        stamps = offsets + line.step * rows
        steps.add(np.diff(stamps, prepend=before))
        before = float(stamps[-1])
        ends, firsts = splitter.split(rows, stamps)
        late = (firsts - line.step * ends) / line.step
        if not late.max(initial=0.0) <= _LATEST:
            return None
        np.minimum.at(least, (ends * _PARTS / count).astype(np.int64), late)
        deviations.add(offsets)
    if not np.all(least <= _TOUCHING) or rows_lost_between(steps.values[1:], _APART * bursts.mean):
        return None
    return Grid(BURSTS, line.start, line.step, deviations.std)
