"""Causal classic filters: Butterworth, averages, median, fading memory, notch.

All functions take readings (N,) without gaps. A cut-off is in cycles per sample, 0 to 0.5; a *small* cut-off or a
*long* window smooths more and lags more. Except for the moving average, whose window grows at the start, the filters
start as if all earlier readings were equal to the first. Linear filters work on the differences from the first reading,
so that a large offset costs no digits.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import butter, iirnotch, lfilter, sosfilt, tf2sos

from becalm.core.arrays import Floats

HALF_POWER = 0.443
"""Cut-off times length of a long moving average: sinc(0.443) is -3 dB."""


def butterworth(z: Floats, cutoff: float, order: int) -> Floats:
    """Filter z (N,) by a causal Butterworth low-pass.

    Parameters
    ----------
    z : (N,) float array
        Readings.
    cutoff : float
        -3 dB frequency in cycles per sample, 0 to 0.5; a *small* one smooths more and lags more.
    order : int
        Order, 1 or more.
    """
    sos = butter(order, 2 * cutoff, output="sos")
    filtered: Floats = sosfilt(sos, z - z[0]) + z[0]
    return filtered


def moving_average(z: Floats, length: int) -> Floats:
    """Average each reading of z (N,) with the `length` - 1 readings before it, or with fewer at the start."""
    total = np.concatenate([[0.0], np.cumsum(z - z[0])])
    rows = np.arange(1, len(z) + 1)
    first = np.maximum(rows - length, 0)
    averaged: Floats = (total[rows] - total[first]) / (rows - first) + z[0]
    return averaged


def moving_median(z: Floats, length: int) -> Floats:
    """Return the median of each reading of z (N,) and the `length` - 1 before it; `length` is odd."""
    padded = np.concatenate([np.full(length - 1, z[0]), z])
    filtered: Floats = median_filter(padded, length, origin=(length - 1) // 2, mode="nearest")[length - 1 :]
    return filtered


def fading_memory(z: Floats, cutoff: float, order: int) -> Floats:
    """Filter z (N,) by the exponential average (order 1), the alpha-beta (2) or the alpha-beta-gamma filter (3).

    Parameters
    ----------
    z : (N,) float array
        Readings.
    cutoff : float
        Cut-off of the poles, in cycles per sample: theta = exp(-2 pi cutoff); a *small* one smooths more and lags
        more.
    order : int
        1 to 3; the filter follows a polynomial of lower degree than the order without error.

    Notes
    -----
    The filter is critically damped; its error transfer function is theta^n (1 - 1/z)^n / (1 - theta/z)^n. Source:
    Brookner, Tracking and Kalman Filtering Made Easy (1998), chapter 1.
    """
    theta = float(np.exp(-2 * np.pi * cutoff))
    denominator = np.poly(np.full(order, theta))
    numerator = denominator - theta**order * np.poly(np.ones(order))
    filtered: Floats = lfilter(numerator, denominator, z - z[0]) + z[0]
    return filtered


def notch(z: Floats, frequency: float, quality: float = 30.0) -> Floats:
    """Remove one frequency, in cycles per sample, from z (N,); a *small* quality removes a wide band and rings less."""
    sos = tf2sos(*iirnotch(2 * frequency, quality))
    filtered: Floats = sosfilt(sos, z - z[0]) + z[0]
    return filtered


def length_of(cutoff: float, odd: bool = False) -> int:
    """Return the length of a moving average with a cut-off in cycles per sample: readings, at least 1, odd if asked."""
    length = HALF_POWER / cutoff
    return 2 * round((length - 1) / 2) + 1 if odd else max(1, round(length))
