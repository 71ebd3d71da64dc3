"""The cumulative sum that finds a small lasting shift of white noise: how soon, and how often it is wrong.

S_i = max(0, S_{i-1} + x_i - k), alarm and start anew where S reaches h (Page 1954), as `native/monitor.h` sums it. Its
mean time to an alarm, of noise of mean mu, is (exp(-2 d b) + 2 d b - 1) / (2 d^2) with d = mu - k and b = h + 1.166:
Siegmund, Sequential Analysis (1985), chapter 10; within a few per cent here.
"""

from __future__ import annotations

import numpy as np

SLACK = 0.5
"""k, in sigma: half of the shift that is found soonest."""

_OVERSHOOT = 1.166  # a discrete walk passes h by 0.583 on either end


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
