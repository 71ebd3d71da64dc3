"""Classic filters that know the whole record, and have no lag: both ways, centred, or by least squares.

All take readings (N,) without gaps; a *small* cut-off, or a *long* window, smooths more.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solveh_banded
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.signal import butter, savgol_filter, sosfiltfilt

from becalm.core.arrays import Floats

_STIFFEST = 1e13  # weight of differences beyond which float64 no longer solves for what is smoothed
_SPREAD = 1.4826  # times the median deviation of Gaussian noise is its sigma


def butterworth_both_ways(z: Floats, cutoff: float, order: int) -> Floats:
    """Filter z (N,) by a Butterworth low-pass forward and back, without lag.

    Parameters
    ----------
    z : (N,) float array
        Readings.
    cutoff : float
        -3 dB frequency of each way in cycles a sample, 0 to 0.5; a *small* one smooths more.
    order : int
        Of each way, 1 or more.
    """
    sos = butter(order, 2 * cutoff, output="sos")
    filtered: Floats = sosfiltfilt(sos, z, padlen=min(3 * (2 * len(sos) + 1), len(z) - 1))
    return filtered


def savitzky_golay(z: Floats, length: int, degree: int) -> Floats:
    """Fit a polynomial of a degree to the `length` (odd) readings of z (N,) around each; a *small* length trusts z."""
    fitted: Floats = savgol_filter(z, length, degree)
    return fitted


def centred_average(z: Floats, length: int) -> Floats:
    """Average the `length` (odd) readings of z (N,) around each; at the ends the record is mirrored."""
    averaged: Floats = uniform_filter1d(z - z[0], length, mode="mirror") + z[0]
    return averaged


def centred_median(z: Floats, length: int) -> Floats:
    """Return the median of the `length` (odd) readings of z (N,) around each; at the ends the record is mirrored."""
    filtered: Floats = median_filter(z, length, mode="mirror")
    return filtered


def hampel(z: Floats, length: int, sigmas: float = 3.0) -> Floats:
    """Put the median in the place of what is far from it, and leave all other readings of z (N,) as they are.

    Parameters
    ----------
    z : (N,) float array
        Readings.
    length : int
        Odd: readings around each.
    sigmas : float
        How far; a *small* one believes little.

    Notes
    -----
    Hampel, Journal of the American Statistical Association 69 (1974) 383.
    """
    middle = centred_median(z, length)
    spread = _SPREAD * centred_median(np.abs(z - middle), length)
    return np.where(np.abs(z - middle) > sigmas * spread, middle, z)


def whittaker(z: Floats, cutoff: float, order: int = 2) -> Floats:
    """Smooth z (N,) by penalised least squares: minimise |z - x|^2 + lambda |D^order x|^2.

    Parameters
    ----------
    z : (N,) float array
        Readings.
    cutoff : float
        Where half of the amplitude passes, in cycles a sample: lambda = (2 sin(pi cutoff))^(-2 order); a *small* one
        smooths more.
    order : int
        Of the differences, 1 or more.

    Notes
    -----
    Whittaker, Proceedings of the Edinburgh Mathematical Society 41 (1923) 63; Eilers, Analytical Chemistry 75 (2003)
    3631. It is the smoother of an integrated random walk of that order with q/r = 1/lambda.
    """
    weight = min((2 * np.sin(np.pi * cutoff)) ** (-2 * order), _STIFFEST)
    differences = np.poly(np.ones(order))
    bands = np.zeros((order + 1, len(z)))
    bands[order] = 1.0
    for first in range(order + 1):
        for second in range(first, order + 1):
            rows = slice(second, len(z) - order + second)
            bands[order - (second - first), rows] += weight * differences[first] * differences[second]
    smoothed: Floats = solveh_banded(bands, z)
    return smoothed
