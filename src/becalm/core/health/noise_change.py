"""From when on noise is another: mean squares of innovations over a record of any length, in constant memory.

A change is told only where what was before it is as even as chance leaves noise, and what came after it too:
then it is no motion that comes and goes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.native.scans import HOP

_LEAST = 4  # hops whose mean square is taken together
_MOST = 2048  # blocks that are held; then each two become one
_FEWEST = 8  # blocks on either side of a change
_RATIO = 1.5  # of standard deviations, below which a change is none worth telling
_UNEVEN = 4.0  # times what chance leaves Gaussian noise; heavy tails have up to three


class NoiseChanged(NamedTuple):
    """A change of noise."""

    step: float  # steps from the first row to where it came, to within a block
    ratio: float  # standard deviation of the innovations after it over that before


class NoiseHistory:
    """Remembers how large the innovations of one channel were, and when; blocks grow with the record."""

    def __init__(self) -> None:
        self._powers, self._steps = np.empty(0), np.empty(0)  # of hops that make no block yet
        self._means, self._starts = np.empty(0), np.empty(0)
        self._size = _LEAST  # hops in a block

    def push(self, powers: Floats, steps: Floats) -> None:
        """Take the next hops: the sums of their squared innovations, in sigma^2, and when each began, in steps."""
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
        """Return the mean squares of blocks, by halves, so that they are the same whenever blocks grew."""
        means = powers / HOP
        for _ in range(self._size.bit_length() - 1):
            means = (means[::2] + means[1::2]) / 2
        return means

    def change(self) -> NoiseChanged | None:
        """Return the change that splits the record best; None where there is none, or noise is not even beside it.

        The split is that of the greatest likelihood of Gaussian noise of two variances.
        """
        means, count = self._means, len(self._means)
        if count < 2 * _FEWEST or not means.min() > 0:
            return None
        split = np.arange(_FEWEST, count - _FEWEST + 1)
        before = np.cumsum(means)[split - 1] / split
        after = np.cumsum(means[::-1])[count - split - 1] / (count - split)
        at = int(np.argmin(split * np.log(before) + (count - split) * np.log(after)))
        k, ratio = int(split[at]), float(np.sqrt(after[at] / before[at]))
        told = max(ratio, 1 / ratio) >= _RATIO and all(map(self._is_even, (means[:k], means[k:])))
        return NoiseChanged(float(self._starts[k]), ratio) if told else None

    def _is_even(self, means: Floats) -> bool:
        """Return whether blocks differ by no more than mean squares of noise do."""
        return bool(means.var(ddof=1) <= _UNEVEN * 2 / (self._size * HOP) * means.mean() ** 2)


def said_of_change(change: NoiseChanged | None, step_s: float) -> list[str]:
    """Say from when on the noise was another, and what to do; nothing where it was not."""
    if change is None:
        return []
    louder = "tune anew on a record of this, or look for what shakes the sensor"
    quieter = "tune anew if it stays so; a machine at rest needs nothing"
    return [
        f"From {change.step * step_s:.6g} s on the noise is {change.ratio:.2g} times what it was before:"
        f" {louder if change.ratio > 1 else quieter}."
    ]
