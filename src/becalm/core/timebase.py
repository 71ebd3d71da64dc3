"""When the samples were taken: the rate by median, jitter, gaps, repeats, reversals.

Stamps that lie on a straight line but for the rounding of their last digit are *uniform*
(with whole steps missing where there are gaps); all others are *stamped* and used as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, Integers, frozen, real
from becalm.errors import TimeError

GAP_STEPS = 1.5
"""A distance of more than this many median steps is a gap."""

SLOWEST_HZ, FASTEST_HZ = 1e-9, 1e12
"""Rates outside are typing errors: a sample in thirty years, or a million in a microsecond."""

_FINEST_DIGIT = 9
_ROUNDING = 0.55  # half a last digit, and a little for the fit
_WAY_OUT = "Mend the column, name another with --time, or give --rate HZ to count rows instead."
_CLOCK = 1e-6  # of a step: what floating-point stamps lose without being rounded on purpose


@dataclass(frozen=True)
class Timebase:
    """Times of N samples.

    Attributes
    ----------
    elapsed_steps : (N,) float array
        Time since the sample before, in steps of `step_s`; 0 for the first. Whole numbers when
        the time is uniform.
    step_s : float
        One step in seconds: the median distance of two samples.
    start_s : float
        Time of the first sample, in seconds.
    uniform : bool
        Whether every distance is a whole number of steps.
    jitter_s : float
        Standard deviation of one stamp about its place, in seconds: about the even grid of uniform
        time; of the distances over the root of two otherwise, gaps left aside.
    """

    elapsed_steps: Floats
    step_s: float
    start_s: float = 0.0
    uniform: bool = True
    jitter_s: float = 0.0

    @classmethod
    def even(cls, count: int, rate_hz: float, start_s: float = 0.0) -> Timebase:
        """Make the time of `count` samples at `rate_hz`, none missing.

        Raises
        ------
        TimeError
            If the rate is not a positive number.
        """
        try:
            possible = SLOWEST_HZ <= float(rate_hz) <= FASTEST_HZ and not isinstance(rate_hz, str)
        except (TypeError, ValueError):
            possible = False
        if not possible:
            raise TimeError(f"rate_hz = {rate_hz!r} is not a rate; give hertz, {SLOWEST_HZ:g} to {FASTEST_HZ:g}.")
        elapsed = np.ones(count)
        elapsed[:1] = 0.0
        return cls(frozen(elapsed), 1.0 / float(rate_hz), float(start_s))

    @classmethod
    def from_stamps(cls, times_s: ArrayLike) -> Timebase:
        """Understand a column of stamps, in seconds.

        Raises
        ------
        TimeError
            If a stamp is missing, time goes backwards, or too few stamps differ to tell a rate.
        """
        try:
            stamps = np.array(real(times_s), dtype=np.float64)
        except (TypeError, ValueError) as cause:
            raise TimeError(f"times_s is not numbers of seconds ({cause}).") from cause
        if stamps.ndim != 1:
            raise TimeError(f"times_s has shape {stamps.shape}; one stamp a sample, (N,), is needed.")
        _refuse_unfinished(stamps)
        distances = np.diff(stamps)
        _refuse_impossible(stamps, distances)
        step = float(np.median(distances))
        near = distances[distances <= GAP_STEPS * step]
        steps = np.round(distances / near.mean())  # the mean, since rounding moves the median
        grid = np.concatenate([[0.0], np.cumsum(steps)])
        fitted, residual = _line(grid, stamps)
        tolerance = max(_ROUNDING * _last_digit(stamps), _CLOCK * step) + 2 * np.spacing(np.abs(stamps).max())
        if np.all(steps >= 1) and np.abs(residual).max() <= tolerance:
            elapsed = np.concatenate([[0.0], steps])
            return cls(frozen(elapsed), _twelve_digits(fitted), float(stamps[0]), True, float(residual.std()))
        elapsed = np.concatenate([[0.0], distances / step])
        return cls(frozen(elapsed), step, float(stamps[0]), False, float((near - step).std() / np.sqrt(2)))

    @property
    def count(self) -> int:
        """Number of samples."""
        return len(self.elapsed_steps)

    @property
    def rate_hz(self) -> float:
        """Samples per second, by the median step."""
        return 1.0 / self.step_s

    @cached_property
    def times_s(self) -> Floats:
        """Time of each sample, (N,), in seconds."""
        return frozen(self.start_s + self.step_s * np.cumsum(self.elapsed_steps))

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last, in seconds."""
        return float(self.step_s * self.elapsed_steps.sum())

    @property
    def gaps(self) -> Integers:
        """Rows before which more than 1.5 steps passed."""
        return np.flatnonzero(self.elapsed_steps > GAP_STEPS).astype(np.int64)

    @property
    def repeats(self) -> Integers:
        """Rows with the same time as the row before."""
        return (np.flatnonzero(self.elapsed_steps[1:] == 0.0) + 1).astype(np.int64)


def _refuse_unfinished(stamps: Floats) -> None:
    if len(stamps) < 2:
        rows = "One row has" if len(stamps) else "No rows have"
        raise TimeError(f"{rows} no rate; two or more are needed. Give --rate HZ.")
    if not np.isfinite(stamps).all():
        row = int(np.flatnonzero(~np.isfinite(stamps))[0])
        raise TimeError(f"The time of row {row + 1} is missing or not finite. {_WAY_OUT}")


def _refuse_impossible(stamps: Floats, distances: Floats) -> None:
    if (distances < 0).any():
        row = int(np.flatnonzero(distances < 0)[0]) + 1
        count = int((distances < 0).sum())
        raise TimeError(
            f"Time goes backwards at row {row + 1}, from {stamps[row - 1]:.9g} s to {stamps[row]:.9g} s"
            f" ({count} such row{'s' if count > 1 else ''}). {_WAY_OUT}"
        )
    if not (np.median(distances) > 0):
        raise TimeError(f"More than half of the rows repeat the time of the row before. {_WAY_OUT}")


def _line(grid: Floats, stamps: Floats) -> tuple[float, Floats]:
    """Fit stamps = start + step * grid; the slope and the residuals."""
    g, s = grid - grid.mean(), stamps - stamps.mean()
    slope = float(g @ s / (g @ g))
    return slope, s - slope * g


def _twelve_digits(step_s: float) -> float:
    """Round the rate to what stamps can tell, so that 100 Hz is not 99.9999999999997 Hz."""
    return 1.0 / float(f"{1.0 / step_s:.12g}")


def _last_digit(stamps: Floats) -> float:
    """Find the decimal place that the stamps are rounded to, in seconds; 0 if none is seen."""
    some = stamps[:: max(1, len(stamps) // 1000)]
    for place in range(_FINEST_DIGIT + 1):
        scaled = some * 10.0**place
        slack = 1e-3 + 4e-16 * np.abs(scaled)
        if np.all(np.abs(scaled - np.round(scaled)) <= slack):
            return float(10.0**-place)
    return 0.0
