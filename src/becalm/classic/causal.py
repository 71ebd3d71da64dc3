"""Causal classic filters: Butterworth low-pass and moving average."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from becalm.core.arrays import Floats


def butterworth(z: Floats, cutoff: float, order: int) -> Floats:
    """Filter z (N,) by a causal Butterworth low-pass, started at the first reading.

    Parameters
    ----------
    z : (N,) float array
        Readings.
    cutoff : float
        -3 dB frequency in cycles a sample, 0 to 0.5; a *small* one smooths more and lags more.
    order : int
        1 or more.
    """
    sos = butter(order, 2 * cutoff, output="sos")
    filtered: Floats = sosfilt(sos, z, zi=sosfilt_zi(sos) * z[0])[0]
    return filtered


def moving_average(z: Floats, length: int) -> Floats:
    """Average each reading of z (N,) with the `length` - 1 before it; at the start, with those there are."""
    total = np.concatenate([[0.0], np.cumsum(z - z[0])])
    rows = np.arange(1, len(z) + 1)
    first = np.maximum(rows - length, 0)
    averaged: Floats = (total[rows] - total[first]) / (rows - first) + z[0]
    return averaged
