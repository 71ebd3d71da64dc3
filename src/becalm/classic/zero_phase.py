"""Classic filters that know the whole record, and have no lag: both ways, centred, or by least squares.

All take readings (N,) without gaps; a *small* cut-off, or a *long* window, smooths more. What is linear filters what
readings differ from the first, so that a large offset costs no digits.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import solveh_banded
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.signal import butter, oaconvolve, sosfiltfilt

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
    filtered: Floats = sosfiltfilt(sos, z - z[0], padlen=min(3 * (2 * len(sos) + 1), len(z) - 1)) + z[0]
    return filtered


def savitzky_golay(z: Floats, length: int, degree: int) -> Floats:
    """Fit a polynomial of a degree to the readings of z (N,) around each; within half a window of an end, one to all.

    Parameters
    ----------
    z : (N,) float array
        Readings, as many as the window at the least.
    length : int
        Of the window in readings, odd, more than the degree; a *small* one trusts z.
    degree : int
        0 or more.

    Notes
    -----
    Savitzky and Golay, Analytical Chemistry 36 (1964) 1627. Legendre polynomials keep the fit of a long window exact;
    powers of the row, as `scipy.signal.savgol_filter` takes them, lose degree 4 from some hundred readings on.
    """
    basis = np.linalg.qr(legvander(np.linspace(-1, 1, length), degree))[0]  # (length, degree + 1)
    apart, half = z - z[0], length // 2
    first, last = (basis @ (basis.T @ window) for window in (apart[:length], apart[len(z) - length :]))
    middle = oaconvolve(apart, basis @ basis[half], "valid")
    return np.asarray(np.concatenate([first[:half], middle, last[half + 1 :]]) + z[0])


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
    3631. It is the smoother of an integrated random walk of that order with q/r = 1/lambda. Solved is for what is taken
    away, D' (D D' + 1/lambda)^-1 D z, which is exact where nothing is: of a polynomial below that order. lambda stops
    at 1e13: order 2 is never slower than 9e-5 cycles a sample, order 3 than 1e-3.
    """
    bends = np.diff(z, order)
    if not len(bends):
        return z.copy()
    weight = min((2 * np.sin(np.pi * cutoff)) ** (-2 * order), _STIFFEST)
    difference = np.poly(np.ones(order))[::-1]
    squares = np.correlate(difference, difference, "full")[: order + 1]  # each diagonal of D D' is constant
    bands = np.repeat(squares[:, np.newaxis], len(bends), axis=1)
    bands[order] += 1 / weight
    return np.asarray(z - np.convolve(solveh_banded(bands[-len(bends) :], bends), difference))
