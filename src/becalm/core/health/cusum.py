"""Delay and false alarms of the cumulative sum that detects a small lasting shift of white noise.

S_i = max(0, S_{i-1} + x_i - k); when S reaches h there is an alarm, and S restarts at 0 (Page 1954). `native/monitor.h`
computes it. For noise of mean mu, the mean time to an alarm is (exp(-2 d b) + 2 d b - 1) / (2 d^2) with d = mu - k and
b = h + 1.166: Siegmund, Sequential Analysis (1985), chapter 10; accurate to a few per cent here.
"""

from __future__ import annotations

import numpy as np

SLACK = 0.5
"""k, in sigma: half of the shift that is detected soonest."""

_OVERSHOOT = 1.166  # a discrete walk overshoots by 0.583 at either end


def cusum_delay(threshold: float, shift: float) -> float:
    """Return the mean number of readings until the alarm of a one-sided sum.

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
    """Return h, in sigma, for which a two-sided sum raises one false alarm per `readings` readings of white noise."""
    b = 1.0
    for _ in range(60):  # fixed-point iteration b = ln(...) / 2k; it contracts because the slope is below 1 for b > 1
        b = float(np.log(2 * SLACK**2 * 2 * readings + 2 * SLACK * b + 1)) / (2 * SLACK)
    return max(b - _OVERSHOOT, 0.0)
