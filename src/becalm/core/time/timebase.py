"""The time base of a recording: step, jitter, gaps and repeats.

Stamps that lie on a straight line except for the rounding of their last digit are *uniform*: their gaps are whole
steps. All other stamps are *stamped* and are used unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, Integers, frozen, read_only, real
from becalm.core.time.clock import FASTEST_HZ, GAP_STEPS, SLOWEST_HZ, Clock
from becalm.errors import TimeError

__all__ = ["FASTEST_HZ", "GAP_STEPS", "SLOWEST_HZ", "Clock", "Timebase"]

_BLOCK = 1 << 16


@dataclass(frozen=True)
class Timebase:
    """Times of N samples.

    Attributes
    ----------
    elapsed_steps : (N,) float array
        Time since the previous sample, in units of `step_s`; 0 for the first sample. The numbers are whole if the time
        is uniform.
    step_s : float
        One step, in seconds: the slope if the stamps lie on a line, otherwise their median difference.
    start_s : float
        Time of the first sample, in seconds.
    uniform : bool
        True if every difference of stamps is a whole number of steps.
    jitter_s : float
        Standard deviation of a stamp, in seconds: for uniform time, its distance from the even grid; otherwise the
        standard deviation of all differences except gaps, over the root of two.
    resolution_s : float
        Last digit that the stamps are rounded to, in seconds; 0 if they are not rounded, or if rows are counted.
    """

    elapsed_steps: Floats
    step_s: float
    start_s: float = 0.0
    uniform: bool = True
    jitter_s: float = 0.0
    resolution_s: float = 0.0

    @classmethod
    def even(cls, count: int, rate_hz: float, start_s: float = 0.0) -> Timebase:
        """Return the time base of `count` samples at `rate_hz`, without gaps.

        Raises
        ------
        TimeError
            If the rate is not a number from `SLOWEST_HZ` to `FASTEST_HZ`.
        """
        clock = Clock.counted(count, rate_hz, start_s)
        return cls.of(clock, clock.elapsed_rows(0, count))

    @classmethod
    def from_stamps(cls, times_s: ArrayLike) -> Timebase:
        """Return the time base of a column of stamps, in seconds.

        Raises
        ------
        TimeError
            If a stamp is missing, time goes backwards, or too few stamps differ for a rate.
        """
        try:
            stamps = np.asarray(real(times_s), dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as cause:
            raise TimeError(f"times_s is not an array of numbers, in seconds ({cause}).") from cause
        if stamps.ndim != 1:
            raise TimeError(f"times_s has shape {stamps.shape}; one stamp per sample, (N,), is needed.")
        starts = range(0, len(stamps), _BLOCK)
        clock = Clock.from_stamps(len(stamps), lambda: (stamps[start : start + _BLOCK] for start in starts))
        return cls.of(clock, clock.elapsed(stamps))

    @classmethod
    def of(cls, clock: Clock, elapsed_steps: Floats) -> Timebase:
        """Return the time base for a clock and the elapsed steps before its rows; the array is not copied."""
        values = (clock.step_s, clock.start_s, clock.uniform, clock.jitter_s, clock.resolution_s)
        return cls(read_only(elapsed_steps), *values)

    @property
    def count(self) -> int:
        """Return the number of samples."""
        return len(self.elapsed_steps)

    @property
    def rate_hz(self) -> float:
        """Return the samples per second, 1 over the step."""
        return 1.0 / self.step_s

    @cached_property
    def times_s(self) -> Floats:
        """Return the time of each sample, (N,), in seconds."""
        return frozen(self.start_s + self.step_s * np.cumsum(self.elapsed_steps))

    @property
    def duration_s(self) -> float:
        """Return the time from the first sample to the last, in seconds."""
        return float(self.step_s * self.elapsed_steps.sum())

    @property
    def gaps(self) -> Integers:
        """Return the rows (k,) that come more than 1.5 steps after the previous row."""
        return np.flatnonzero(self.elapsed_steps > GAP_STEPS).astype(np.int64)

    @property
    def repeats(self) -> Integers:
        """Return the rows (k,) with the same time as the previous row."""
        return (np.flatnonzero(self.elapsed_steps[1:] == 0.0) + 1).astype(np.int64)
