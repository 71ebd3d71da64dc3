"""Measures of the error of a signal whose true values are known."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats


def rms_error(signal: Floats, truth: Floats) -> float:
    """Return the root mean square of signal minus truth, in their unit; NaN is ignored."""
    return float(np.sqrt(np.nanmean((signal - truth) ** 2)))


def coverage(signal: Floats, sigma: Floats, truth: Floats) -> float:
    """Return the share of samples whose truth lies within one sigma of the signal; 0.683 is ideal."""
    estimated = np.isfinite(signal) & np.isfinite(sigma) & np.isfinite(truth)
    return float(np.mean(np.abs(signal - truth)[estimated] <= sigma[estimated]))
