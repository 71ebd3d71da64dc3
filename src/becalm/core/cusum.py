"""The cumulative sum that finds a small lasting shift of white noise, and how often it is wrong.

S_i = max(0, S_{i-1} + x_i - k), alarm and start anew where S reaches h (Page 1954). As a cumulative sum C less its
least value so far it needs no loop (Lindley), and in whole numbers it is exact. Its mean time to an alarm, of noise
of mean mu, is (exp(-2 d b) + 2 d b - 1) / (2 d^2) with d = mu - k and b = h + 1.166: Siegmund, Sequential
Analysis (1985), chapter 10; within a few per cent here.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Integers

SLACK = 0.5
"""k, in sigma: half of the shift that is found soonest."""

_OVERSHOOT = 1.166  # a discrete walk passes h by 0.583 on either end
_SHORTEST, _LONGEST = 64, 4096  # pieces: short after an alarm, because what follows one is looked at again


def cusum_delay(threshold: float, shift: float) -> float:
    """Return how many readings a one-sided sum takes to its alarm, on average.

    Parameters
    ----------
    threshold : float
        h, in sigma.
    shift : float
        Mean of the noise, in sigma; 0 gives the time between false alarms.
    """
    d, b = shift - SLACK, threshold + _OVERSHOOT
    if d == 0:
        return b * b
    return float((np.exp(-2 * d * b) + 2 * d * b - 1) / (2 * d * d))


def cusum_threshold(readings: float) -> float:
    """Return h, in sigma, with which a two-sided sum raises one false alarm in so many `readings` of white noise."""
    b = 1.0
    for _ in range(60):  # a contraction: b = ln(...) / 2k, whose slope is below 1 where b is above 1
        b = float(np.log(2 * SLACK**2 * 2 * readings + 2 * SLACK * b + 1)) / (2 * SLACK)
    return max(b - _OVERSHOOT, 0.0)


class OneSidedCusum:
    """A cumulative sum that goes on from push to push.

    Parameters
    ----------
    threshold : int
        h, in parts of a sigma.
    """

    def __init__(self, threshold: int) -> None:
        self._threshold = threshold
        self._sum = 0
        self._since = 0  # the row after the last in which the sum was 0

    def push(self, steps: Integers, rows: Integers) -> tuple[Integers, int | None]:
        """Add x - k, (B,), of these rows; return the places of alarms, and the row in which the first began."""
        alarms: list[int] = []
        began: int | None = None
        at, piece = 0, _LONGEST
        while at < len(steps):
            end, alarmed = self._add(steps[at : at + piece], rows[at : at + piece])
            piece = _SHORTEST if alarmed else min(2 * piece, _LONGEST)
            if alarmed:
                alarms.append(at + end - 1)
                began = self._since if began is None else began
                self._sum, self._since = 0, int(rows[at + end - 1]) + 1
            at += end
        return np.array(alarms, dtype=np.int64), began

    def _add(self, steps: Integers, rows: Integers) -> tuple[int, bool]:
        """Add steps up to an alarm; return how many were added, and whether there was one."""
        walk = np.cumsum(steps)
        sums = walk - np.minimum(np.minimum.accumulate(walk), -self._sum)
        above = sums >= self._threshold
        alarmed = bool(above.any())
        end = int(np.argmax(above)) + 1 if alarmed else len(steps)
        at_zero = np.flatnonzero(sums[:end] == 0)
        if len(at_zero):
            self._since = int(rows[at_zero[-1]]) + 1
        self._sum = int(sums[end - 1])
        return end, alarmed
