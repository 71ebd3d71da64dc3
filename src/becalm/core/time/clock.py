"""Clock: rate, jitter and gaps of any number of time stamps, computed in passes over blocks in constant memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.errors import TimeError

# Statistics of values that come in blocks, in constant memory: a subset of the values, their mean and scatter.

_MOST_KEPT = 1 << 20  # largest number of values that are kept
_RUN = 1 << 10  # number of values in a run


class Thinned:
    """A store of up to about a million values: all added values, or evenly spread runs of a thousand of them.

    Parameters
    ----------
    count : int
        Number of values that will be added.
    """

    def __init__(self, count: int) -> None:
        self._period = _RUN * max(1, -(-count // _MOST_KEPT))
        self._at = 0
        self._kept: list[Floats] = []

    def add(self, values: Floats) -> None:
        """Add the next values."""
        if self._period == _RUN:
            self._kept.append(values.copy())
        else:
            for start in range(-(self._at % self._period), len(values), self._period):
                if start + _RUN > 0:
                    self._kept.append(values[max(0, start) : start + _RUN].copy())
        self._at += len(values)

    @property
    def values(self) -> Floats:
        """Return the stored values, in order."""
        return np.concatenate(self._kept) if self._kept else np.empty(0)


class Moments:
    """Count and mean of values, and sums of squares and products of their deviations, updated by blocks (Chan)."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = self.other = self.scatter = self.product = 0.0

    def add(self, values: Floats, others: Floats | None = None) -> None:
        """Add a block of values (n,); `others` (n,) are the second factors of the products."""
        count, mean = len(values), float(values.mean()) if len(values) else 0.0
        if not count:
            return
        total = self.count + count
        weight, moved = self.count * count / total, mean - self.mean
        centred = values - mean
        if others is not None:
            other = float(others.mean())
            aside = others - other
            shift = other - self.other
            self.product += _dot(centred, aside) + moved * shift * weight
            self.other += shift * count / total
        self.scatter += _dot(centred, centred) + moved * moved * weight
        self.mean += moved * count / total
        self.count = total

    @property
    def std(self) -> float:
        """Return the standard deviation of all values."""
        return float(np.sqrt(self.scatter / self.count))


def _dot(one: Floats, other: Floats) -> float:
    """Return the dot product, computed in one thread, because BLAS threads wait for each other on a busy machine."""
    return float(np.einsum("i,i", one, other))


GAP_STEPS = 1.5
"""A distance of more than this many median steps is a gap."""

SLOWEST_HZ, FASTEST_HZ = 1e-9, 1e12
"""Smallest and largest possible rate: one sample in thirty years, and a million samples per microsecond."""

Blocks = Callable[[], Iterable[Floats]]
"""A function that returns an iterator over the stamps in blocks that are not empty; it may be called many times."""

_FINEST_DIGIT = 9  # largest number of decimal places of a stamp
_ROUNDING = 0.55  # largest rounding error of a stamp, over its last digit: a half, and a margin for the fit
_ADVICE = "Correct the column, name another with --time, or give --rate HZ to count rows instead."
_FEWEST_UNEVEN = 10  # least number of gaps and repeats that may be rounding; fewer fall on a line by chance
_UNLIKE = 0.05  # least share of stamps that are not shared by two rows, if most are; see `even_grid`
_FLOAT_ERROR = 1e-6  # error of floating-point stamps that were not rounded to a digit, over the step


@dataclass(frozen=True)
class Clock:
    """A summary of the times of `count` samples, without the times: step, gaps, jitter.

    Attributes
    ----------
    count : int
        Number of samples.
    step_s : float
        One step, in seconds: the slope if the stamps lie on a line, otherwise their median difference.
    start_s : float
        Time of the first sample, in seconds.
    uniform : bool
        True if every difference of stamps is a whole number of steps.
    jitter_s : float
        See `Timebase`.
    near_s : float
        The difference of stamps that counts as one elapsed step: for uniform time, the mean of all differences that
        are not gaps, because rounding shifts the median; otherwise the median.
    duration_s : float
        Time from the first sample to the last, in seconds.
    gaps : int
        Number of rows that come more than 1.5 steps after the row before.
    repeats : int
        Number of rows with the same time as the row before.
    resolution_s : float
        See `Timebase`.
    """

    count: int
    step_s: float
    start_s: float = 0.0
    uniform: bool = True
    jitter_s: float = 0.0
    near_s: float = 0.0
    duration_s: float = 0.0
    gaps: int = 0
    repeats: int = 0
    resolution_s: float = 0.0

    @classmethod
    def counted(cls, count: int, rate_hz: float, start_s: float = 0.0) -> Clock:
        """Return the clock of rows at `rate_hz`, without gaps.

        Raises
        ------
        TimeError
            If the rate is not a number from `SLOWEST_HZ` to `FASTEST_HZ`.
        """
        try:
            possible = SLOWEST_HZ <= float(rate_hz) <= FASTEST_HZ and not isinstance(rate_hz, str | bool)
        except (TypeError, ValueError, OverflowError):
            possible = False
        if not possible:
            raise TimeError(f"rate_hz = {rate_hz!r} is not a rate; give hertz, {SLOWEST_HZ:g} to {FASTEST_HZ:g}.")
        step = 1.0 / float(rate_hz)
        return cls(count, step, float(start_s), near_s=step, duration_s=step * max(0, count - 1))

    @classmethod
    def from_stamps(cls, count: int, blocks: Blocks) -> Clock:
        """Return the clock of stamps in seconds; this takes a few passes over the stamps, each in constant memory.

        Parameters
        ----------
        count : int
            Number of stamps.
        blocks : callable
            Function that returns an iterator over the stamps in order, as (n,) float arrays; each pass calls it once.
            For more than a million stamps, the median is that of evenly spread runs of stamps.

        Raises
        ------
        TimeError
            If a stamp is missing, time goes backwards, too few stamps differ for a rate, or the rate is impossible.

        Notes
        -----
        Where the last digit of stamps is about a step, as for 833 Hz in milliseconds, steps of one or two digits may be
        lost rows or rounding. They are rounding if all stamps lie on a line over the row number, as no stamps do from
        which rows are lost by chance. Every sixth row of 1 kHz lost cannot be told from 833 Hz, and is read as 833 Hz.
        """
        summary = _summarise(count, blocks)
        mean = (summary.last - summary.first) / (count - 1)
        offsets, gaps, repeats = _offsets(summary.step, blocks)
        spacing = float(np.spacing(max(abs(summary.first), abs(summary.last))))
        tolerance = max(_ROUNDING * summary.digit, _FLOAT_ERROR * summary.step) + 2 * spacing
        pairs = abs(max(summary.digit, spacing) / mean - 2.0) < _UNLIKE  # two rows a stamp may be meant
        if gaps + repeats >= _FEWEST_UNEVEN and not pairs:
            even = _fit(mean, summary, blocks, tolerance - spacing, by_row=True)
            if even is not None:
                return cls._uniform(count, mean, even, summary)
        near = summary.step + offsets.mean
        line = _fit(near, summary, blocks, tolerance)
        if line is not None:
            return cls._uniform(count, near, line, summary)
        jitter = offsets.std / np.sqrt(2)
        values = (jitter, summary.step, summary.last - summary.first, gaps, repeats, summary.digit)
        return cls(count, summary.step, summary.first, False, *values)

    @classmethod
    def _uniform(cls, count: int, near: float, line: _Line, summary: _Summary) -> Clock:
        """Return the clock of stamps that lie on a line."""
        step = _twelve_digits(near + line.slope)
        return cls(count, step, summary.first, True, line.std, near, step * line.length, line.gaps, 0, summary.digit)

    @property
    def rate_hz(self) -> float:
        """Return the samples per second, 1 over the step."""
        return 1.0 / self.step_s

    @property
    def even(self) -> bool:
        """Return whether every row comes one step after the previous row, so that the row number gives the time."""
        return self.uniform and not self.gaps

    def elapsed(self, stamps: Floats, before: float | None = None) -> Floats:
        """Return the elapsed steps before each of the next stamps, (n,); `before` is the stamp before the first one."""
        out = np.ones(len(stamps))
        if self.even:
            out[:1] = before is not None
            return out
        if len(stamps):
            out[0] = 0.0 if before is None else stamps[0] - before
            np.subtract(stamps[1:], stamps[:-1], out=out[1:])
        out /= self.near_s
        return np.round(out, out=out) if self.uniform else out

    def elapsed_rows(self, first: int, count: int, before: int | None = None) -> Floats:
        """Return the elapsed steps before each of `count` rows of even time, from row `first` on; 0 for row 0.

        `before` is the last row before these; by default it is row `first` - 1.
        """
        out = np.ones(count)
        out[:1] = first - (max(0, first - 1) if before is None else before)
        return out


class _Summary(NamedTuple):
    step: float  # median difference of the stamps, in seconds
    first: float  # first stamp, in seconds
    last: float  # last stamp, in seconds
    digit: float  # last digit of the stamps, in seconds; see `last_digit`


class _Line(NamedTuple):
    slope: float  # slope of the offsets from the grid, in seconds per step
    length: float  # number of steps from the first stamp to the last
    gaps: int
    std: float  # standard deviation of the stamps from the line, in seconds


def _walk(blocks: Blocks) -> Iterator[tuple[Floats, Floats]]:
    """Yield each block and the differences before its stamps; the very first stamp has none."""
    before: float | None = None
    for stamps in blocks():
        if before is None:
            yield stamps, np.diff(stamps)
        else:
            distances = np.empty(len(stamps))
            distances[0] = stamps[0] - before
            np.subtract(stamps[1:], stamps[:-1], out=distances[1:])
            yield stamps, distances
        before = float(stamps[-1])


def _summarise(count: int, blocks: Blocks) -> _Summary:
    """Return range, last digit and median step of the stamps; raise an error if the stamps are not valid times."""
    if count < 2:
        rows = "One row has" if count else "0 rows have"
        raise TimeError(f"{rows} no rate; two or more are needed. Give a rate: --rate HZ, or rate_hz=.")
    thinned, samples = Thinned(count - 1), []
    first, last, least, row, every = np.nan, np.nan, np.inf, 0, max(1, count // 1000)
    with np.errstate(invalid="ignore", over="ignore"):
        for stamps, distances in _walk(blocks):
            if row == 0:
                first = float(stamps[0])
            last = float(stamps[-1])
            if not (np.isfinite(last) and distances.min(initial=0.0) >= 0.0):  # NaN fails
                _refuse(blocks)
            samples.append(stamps[-row % every :: every].copy())  # a view would keep the block
            thinned.add(distances)
            least = float(distances.min(initial=least, where=distances > 0))
            row += len(stamps)
        mean, step = (last - first) / (count - 1), float(np.median(thinned.values))
    if not (np.isfinite(first) and step > 0):
        _refuse(blocks)
    if not (mean <= 1 / SLOWEST_HZ and step >= 1 / FASTEST_HZ):
        raise TimeError(f"Rows are {step:.3g} s apart; {1 / FASTEST_HZ:g} to {1 / SLOWEST_HZ:g} s is needed. {_ADVICE}")
    digit = last_digit(np.concatenate(samples))
    return _Summary(step, first, last, digit if digit < 2 * least else 0.0)  # stamps nearer than a digit have more


def _refuse(blocks: Blocks) -> None:
    """Raise the error that describes what is wrong with the stamps."""
    row, count, place = 0, 0, ""
    with np.errstate(invalid="ignore"):
        for stamps, distances in _walk(blocks):
            if not np.isfinite(stamps).all():
                missing = row + _first(~np.isfinite(stamps))
                raise TimeError(f"The time of row {missing + 1} is missing or not finite. {_ADVICE}")
            back = distances < 0
            if back.any() and not count:
                at = _first(back) + len(stamps) - len(distances)
                place = f"row {row + at + 1}, from {stamps[at] - distances[_first(back)]:.9g} s to {stamps[at]:.9g} s"
            count += int(back.sum())
            row += len(stamps)
    if count:
        rows = f"{count} such row{'s' if count > 1 else ''}"
        raise TimeError(f"Time goes backwards at {place} ({rows}). {_ADVICE}")
    raise TimeError(f"More than half of the rows repeat the time of the row before. {_ADVICE}")


def _first(where: Booleans) -> int:
    return int(np.flatnonzero(where)[0])


def _offsets(step: float, blocks: Blocks) -> tuple[Moments, int, int]:
    """Return the moments of all steps except gaps, minus the median step, and the counts of gaps and repeats."""
    offsets, gaps, repeats = Moments(), 0, 0
    for _, distances in _walk(blocks):
        steps = distances / step
        far = steps > GAP_STEPS
        gaps += int(np.count_nonzero(far))
        repeats += int(len(distances) - np.count_nonzero(distances))
        offsets.add((distances if not far.any() else distances[~far]) - step)
    return offsets, gaps, repeats


def _grid(near: float, summary: _Summary, blocks: Blocks, by_row: bool) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Yield whole steps, their running sum (the grid), and the offsets of the stamps from the grid.

    With `by_row` every row is one step after the row before.
    """
    at = 0.0
    for stamps, distances in _walk(blocks):
        steps = np.ones(len(distances)) if by_row else np.round(distances / near)
        grid = np.empty(len(stamps))
        grid[: len(stamps) - len(steps)] = 0.0
        np.cumsum(steps, out=grid[len(stamps) - len(steps) :])
        grid += at
        at = float(grid[-1])
        yield steps, grid, (stamps - summary.first) - near * grid


def _fit(near: float, summary: _Summary, blocks: Blocks, tolerance: float, *, by_row: bool = False) -> _Line | None:
    """Fit a line through the stamps as a function of the grid.

    Return None if a step rounds to 0, or a stamp is farther than the tolerance from the line.
    """
    sums, gaps, end = Moments(), 0, 0.0
    for steps, grid, offset in _grid(near, summary, blocks, by_row):
        if steps.min(initial=1.0) < 1:
            return None
        gaps += int(np.count_nonzero(steps > GAP_STEPS))
        sums.add(grid, offset)
        end = float(grid[-1])
    slope, residuals, worst = sums.product / sums.scatter, Moments(), 0.0
    for _, grid, offset in _grid(near, summary, blocks, by_row):
        residual = (offset - sums.other) - slope * (grid - sums.mean)
        worst = max(worst, float(np.abs(residual).max()))
        residuals.add(residual)
    return _Line(slope, end, gaps, residuals.std) if worst <= tolerance else None


def _twelve_digits(step_s: float) -> float:
    """Return the step whose rate is rounded to twelve digits, so that 100 Hz is not 99.9999999999997 Hz."""
    return 1.0 / float(f"{1.0 / step_s:.12g}")


def last_digit(some: Floats) -> float:
    """Return the place that the stamps are rounded to, in seconds: decimal, or the last of float32; 0 for neither."""
    for place in range(_FINEST_DIGIT + 1):
        scaled = some * 10.0**place
        slack = 1e-3 + 4e-16 * np.abs(scaled)
        if np.all(np.abs(scaled - np.round(scaled)) <= slack):
            return float(10.0**-place)
    single = some.astype(np.float32)
    return float(np.spacing(np.abs(single).max())) if np.array_equal(single, some) else 0.0
