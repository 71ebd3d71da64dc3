"""Find the even grid of the sampling times behind stamps that a driver disturbed.

Two disturbances can be recognised. *Jitter*: every stamp lies near its place on a line, and its error is
independent of its neighbours' errors. *Bursts*: a driver fetches several samples at once and stamps them at nearly
one instant, after all of them were taken. The line is then a lower bound of the first stamps of bursts, just as the
skew of a clock is found from delays that are never negative (Moon, Skelly and Towsley, 1999).
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

_LEAST_JITTER, _MOST_JITTER = 0.02, 0.15  # std in steps: with less, stamps serve; with more, sampling may be uneven
_FARTHEST = 0.45  # steps: an error of half a step could be a lost row
_LAGS = 16  # largest lag, in rows, at which jitter must not be correlated
_CORRELATED = 0.1  # more correlation is not jitter, if it is also above four sigma
_APART = 0.4  # steps: stamps of one burst are closer than this
_LATEST = 1.1  # steps: the driver waits up to one step for a sample, plus a margin
_PARTS, _TOUCHING = 8, 0.25  # if each of the parts has a burst this close to the line, in steps, no row is lost
_FEWEST_BURSTS = 128
_SEVERAL = 1.5  # least mean number of rows per burst
_SIZES = 65  # bursts of up to 64 rows
_UNLIKE = 0.05  # least share of bursts of other sizes: they show that the time between bursts grows with size
_COARSE = 0.75  # least last digit of stamps that are too coarse, over the mean time between bursts
_SEGMENTS = 64  # of a block's bursts; each segment keeps one burst


class Grid(NamedTuple):
    """An even grid of samples.

    Attributes
    ----------
    kind : str
        "jitter" or "bursts".
    start_s, step_s : float
        Time of the first sample and sampling interval, in seconds.
    jitter_s : float
        Standard deviation of the delays of the stamps behind the grid, in seconds.
    """

    kind: str
    start_s: float
    step_s: float
    jitter_s: float


def even_grid(count: int, blocks: Blocks) -> Grid | None:
    """Find the even grid behind stamps without lost rows, in three passes over them and constant memory.

    Parameters
    ----------
    count : int
        Number of stamps.
    blocks : callable
        Returns an iterator over the stamps in seconds, in (n,) blocks; it is called for each pass.

    Returns
    -------
    Grid or None
        None if the stamps show no grid or are not valid times.
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
    return _bursts(count, blocks, bursts) if bursts.clear else _jitter(blocks, line)


class EqualBursts(NamedTuple):
    """Bursts of one size: the stamps alone do not show whether a driver or the sampling made them."""

    rows: int  # in each burst
    rate_hz: float  # mean rate of the rows


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
    """Yield row numbers and the delays of their stamps relative to a line."""
    row = 0
    for stamps in blocks():
        rows = np.arange(row, row + len(stamps), dtype=np.float64)
        yield rows, (stamps - start) - step * rows
        row += len(stamps)


def _jitter(blocks: Blocks, line: _Line) -> Grid | None:
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
    """A splitter of stamps into bursts, each with its first stamp and the row of its last stamp.

    It keeps the burst with the least delay of each segment of a block, for the line below all bursts.
    """

    def __init__(self, first: float, mean: float) -> None:
        self._first, self.mean = first, mean
        self._open: float | None = None  # first stamp of the burst that may continue
        self._before = -np.inf
        self._rows: list[float] = []
        self._stamps: list[float] = []
        self._sizes = np.zeros(_SIZES + 1, np.int64)
        self._ended = -1.0
        self.count = 0

    def add(self, rows: Floats, stamps: Floats) -> None:
        """Add the next rows, (n,), and their stamps relative to the first stamp."""
        self._keep_least_delayed(*self.parted(rows, stamps))

    def parted(self, rows: Floats, stamps: Floats) -> tuple[Floats, Floats]:
        """Return the last row and the first stamp of each burst that ended; the last burst stays open."""
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
    def clear(self) -> bool:
        """Return whether there are bursts of different sizes; equal bursts may be the sampling or several sensors."""
        rows = self._ended + 1.0
        if self.count < _FEWEST_BURSTS or self._sizes[_SIZES] or rows < _SEVERAL * self.count:
            return False
        if last_digit(np.array(self._stamps)) >= _COARSE * self.mean * rows / self.count:
            return False  # truncated stamps, e.g. to whole seconds, are earlier than their samples
        return self.count - int(self._sizes.max()) >= _UNLIKE * self.count

    @property
    def equal(self) -> EqualBursts | None:
        """Return size and rate of the bursts if nearly all have one size; otherwise None."""
        size = int(np.argmax(self._sizes))
        unlike = self.count - int(self._sizes[size])
        if self.count < _FEWEST_BURSTS or not 1 < size < _SIZES or unlike >= _UNLIKE * self.count or not self._open:
            return None
        return EqualBursts(size, float(f"{(self._ended + 1.0) / self._open:.6g}"))

    def below(self) -> _Line:
        """Return the closest line below all first stamps: the middle edge of their lower hull."""
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


def _bursts(count: int, blocks: Blocks, bursts: _Bursts) -> Grid | None:
    line = bursts.below()
    deviations, splitter, least = Moments(), _Bursts(0.0, bursts.mean), np.full(_PARTS, np.inf)
    steps, before = Thinned(count), 0.0
    for rows, offsets in _offsets(blocks, line.start, line.step):
        stamps = offsets + line.step * rows
        steps.add(np.diff(stamps, prepend=before))
        before = float(stamps[-1])
        ends, firsts = splitter.parted(rows, stamps)
        late = (firsts - line.step * ends) / line.step
        if not late.max(initial=0.0) <= _LATEST:
            return None
        np.minimum.at(least, (ends * _PARTS / count).astype(np.int64), late)
        deviations.add(offsets)
    if not np.all(least <= _TOUCHING) or rows_lost_between(steps.values[1:], _APART * bursts.mean):
        return None
    return Grid(BURSTS, line.start, line.step, deviations.std)
