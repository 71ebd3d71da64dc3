"""Detect a change of the noise from mean squares of innovations, for a record of any length, in constant memory.

A change is reported only if the mean squares vary no more than those of noise, both before the change and after it.
This excludes motion that comes and goes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.native.scans import HOP

_LEAST = 4  # hops in a block at first
_MOST = 2048  # largest number of blocks; then each two become one
_FEWEST = 8  # smallest number of blocks on either side of a change
_RATIO = 1.5  # smallest ratio of standard deviations that is reported
_UNEVEN = 4.0  # largest variance of block means, over that of Gaussian noise; heavy tails have up to three


class NoiseChanged(NamedTuple):
    """A change of noise."""

    step: float  # time of the change, in steps from the first row, to within a block
    ratio: float  # standard deviation of the innovations after the change, over that before


class NoiseHistory:
    """The mean squares of one channel's innovations over time, in blocks that grow with the record."""

    def __init__(self) -> None:
        self._powers, self._steps = np.empty(0), np.empty(0)  # hops of an incomplete block
        self._means, self._starts = np.empty(0), np.empty(0)  # complete blocks
        self._size = _LEAST  # hops in a block

    def push(self, powers: Floats, steps: Floats) -> None:
        """Take the next hops: the sums of their squared innovations, in sigma^2, and the steps at which they begin."""
        powers, steps = np.append(self._powers, powers), np.append(self._steps, steps)
        while len(powers) >= self._size:
            hops = min(len(powers) // self._size, _MOST - len(self._means)) * self._size
            self._means = np.append(self._means, self._mean(powers[:hops]))
            self._starts = np.append(self._starts, steps[: hops : self._size])
            powers, steps = powers[hops:], steps[hops:]
            if len(self._means) == _MOST:
                self._means = (self._means[::2] + self._means[1::2]) / 2
                self._starts, self._size = self._starts[::2].copy(), 2 * self._size
        self._powers, self._steps = powers.copy(), steps.copy()

    def _mean(self, powers: Floats) -> Floats:
        """Return the mean squares of blocks; halving repeatedly makes them independent of when blocks grow."""
        means = powers / HOP
        for _ in range(self._size.bit_length() - 1):
            means = (means[::2] + means[1::2]) / 2
        return means

    def change(self) -> NoiseChanged | None:
        """Return the change that splits the record best; None without a change, or if a side varies more than noise.

        The split maximises the likelihood of Gaussian noise with two variances.
        """
        means, count = self._means, len(self._means)
        if count < 2 * _FEWEST or not means.min() > 0:
            return None
        split = np.arange(_FEWEST, count - _FEWEST + 1)
        before = np.cumsum(means)[split - 1] / split
        after = np.cumsum(means[::-1])[count - split - 1] / (count - split)
        at = int(np.argmin(split * np.log(before) + (count - split) * np.log(after)))
        k, ratio = int(split[at]), float(np.sqrt(after[at] / before[at]))
        is_change = max(ratio, 1 / ratio) >= _RATIO and all(map(self._is_even, (means[:k], means[k:])))
        return NoiseChanged(float(self._starts[k]), ratio) if is_change else None

    def _is_even(self, means: Floats) -> bool:
        """Return whether the means of blocks vary no more than those of noise."""
        return bool(means.var(ddof=1) <= _UNEVEN * 2 / (self._size * HOP) * means.mean() ** 2)


def noise_change_message(change: NoiseChanged | None, step_s: float) -> list[str]:
    """Return a sentence with the time and size of the change, and what to do; an empty list without a change."""
    if change is None:
        return []
    louder = "tune again on a record with this noise, or look for what shakes the sensor"
    quieter = "tune again if it stays so; if the machine only rests, nothing is needed"
    return [
        f"From {change.step * step_s:.6g} s on the noise is {change.ratio:.2g} times what it was before:"
        f" {louder if change.ratio > 1 else quieter}."
    ]
