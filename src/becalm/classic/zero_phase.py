"""Classic filters for whole records, without lag: forward and backward, centred, or by least squares.

All functions take readings (N,) without gaps; a *small* cut-off or a *long* window smooths more. Linear filters work on
the differences from the first reading, so that a large offset costs no digits.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import solveh_banded
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.signal import butter, oaconvolve, sosfiltfilt

from becalm.core.arrays import Floats

_STIFFEST = 1e13  # largest weight of the differences for which float64 can solve the equations
_SPREAD = 1.4826  # sigma of Gaussian noise over its median absolute deviation


def butterworth_both_ways(z: Floats, cutoff: float, order: int) -> Floats:
    """Filter z (N,) by a Butterworth low-pass forward and backward, without lag.

    Parameters
    ----------
    z : (N,) float array
        Readings.
    cutoff : float
        -3 dB frequency of each pass in cycles per sample, 0 to 0.5; a *small* one smooths more.
    order : int
        Order of each pass, 1 or more.
    """
    sos = butter(order, 2 * cutoff, output="sos")
    filtered: Floats = sosfiltfilt(sos, z - z[0], padlen=min(3 * (2 * len(sos) + 1), len(z) - 1)) + z[0]
    return filtered


def savitzky_golay(z: Floats, length: int, degree: int) -> Floats:
    """Fit a polynomial to the window around each reading of z (N,); the first and last half window have one fit each.

    Parameters
    ----------
    z : (N,) float array
        Readings, at least as many as the window is long.
    length : int
        Length of the window in readings, odd, more than the degree; a *small* one trusts z.
    degree : int
        Degree of the polynomial, 0 or more.

    Notes
    -----
    Savitzky and Golay, Analytical Chemistry 36 (1964) 1627. Legendre polynomials keep the fit of a long window exact;
    powers, as in `scipy.signal.savgol_filter`, are inaccurate for degree 4 and windows of some hundred readings.
    """
    basis = np.linalg.qr(legvander(np.linspace(-1, 1, length), degree))[0]  # (length, degree + 1)
    shifted, half = z - z[0], length // 2
    first, last = (basis @ (basis.T @ window) for window in (shifted[:length], shifted[len(z) - length :]))
    middle = oaconvolve(shifted, basis @ basis[half], "valid")
    return np.asarray(np.concatenate([first[:half], middle, last[half + 1 :]]) + z[0])


def centred_average(z: Floats, length: int) -> Floats:
    """Average the `length` (odd) readings of z (N,) around each one; the record is mirrored at the ends."""
    averaged: Floats = uniform_filter1d(z - z[0], length, mode="mirror") + z[0]
    return averaged


def centred_median(z: Floats, length: int) -> Floats:
    """Return the median of the `length` (odd) readings of z (N,) around each; the record is mirrored at the ends."""
    filtered: Floats = median_filter(z, length, mode="mirror")
    return filtered


def hampel(z: Floats, length: int, sigmas: float = 3.0) -> Floats:
    """Replace readings of z (N,) that are far from the moving median by this median; the others do not change.

    Parameters
    ----------
    z : (N,) float array
        Readings.
    length : int
        Length of the window in readings, odd.
    sigmas : float
        Largest accepted distance from the median, in sigma; a *small* one replaces more readings.

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
        Frequency that passes with half of its amplitude, in cycles per sample: lambda = (2 sin(pi cutoff))^(-2 order);
        a *small* one smooths more.
    order : int
        Order of the differences, 1 or more.

    Notes
    -----
    Whittaker, Proceedings of the Edinburgh Mathematical Society 41 (1923) 63; Eilers, Analytical Chemistry 75 (2003)
    3631. The result is that of the smoother of an integrated random walk of this order with q/r = 1/lambda. The
    equations are solved for the part to remove, D' (D D' + 1/lambda)^-1 D z, which is exactly 0 for a polynomial of
    lower degree than the order. lambda is at most 1e13: order 2 has a cut-off of at least 9e-5 cycles per sample, order
    3 of at least 1e-3.
    """
    differences = np.diff(z, order)
    if not len(differences):
        return z.copy()
    weight = min((2 * np.sin(np.pi * cutoff)) ** (-2 * order), _STIFFEST)
    difference = np.poly(np.ones(order))[::-1]
    squares = np.correlate(difference, difference, "full")[: order + 1]  # each diagonal of D D' is constant
    bands = np.repeat(squares[:, np.newaxis], len(differences), axis=1)
    bands[order] += 1 / weight
    return np.asarray(z - np.convolve(solveh_banded(bands[-len(differences) :], differences), difference))
