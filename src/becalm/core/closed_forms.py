"""Closed forms of kinematic models and their steady-state filters: cut-offs, spectra, and the limit at high rates.

Time is in steps. Variances are in units of the measurement noise variance, so that r = 1. q is the density of the
noise on the n-th derivative, in unit^2/step^(2n-1); the ratio q/r is defined as in `Tuning.ratio`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Complexes, Floats, frozen

_LOG_STEP = 0.05  # spacing of the logarithms of frequencies
_FOLDS = 16  # aliases on each side that are summed one by one
_LOGARITHMS = np.arange(-40.0, 40.0, _LOG_STEP)  # logarithms of frequency over cut-off


def cutoff_to_ratio(order: int, cutoff: float) -> float:
    """Return q/r = w_n^2n of the kinematic filter with cut-off w_n in radians per step (Notes of `motion`, T = 1)."""
    return float(cutoff ** (2 * order))


def ratio_to_cutoff(order: int, ratio: float) -> float:
    """Return the cut-off of the kinematic filter with q/r, in radians per step; the inverse of `cutoff_to_ratio`."""
    return float(ratio ** (1 / (2 * order)))


def motion_power(order: int, angle: Floats) -> Floats:
    """Return the power (k,), unit^2, of a sampled motion with noise of density 1, at angles (k,) in radians per step.

    Notes
    -----
    White noise integrated `order` times has the power w^-2n. Sampling it once per step folds all
    frequencies w + 2 pi k onto w. The sum of 1 / (x + k) over k is pi cot(pi x). The derivatives of this equation give
    the sum of the folded powers as a polynomial in the cotangent. For a motion with the power S the smoother has the
    frequency response G = S / (S + R).
    """
    *lower, highest = _folded(order).tolist()
    folded = np.full(np.shape(angle), highest)
    with np.errstate(divide="ignore", over="ignore"):
        cotangent_squared = np.tan(angle / 2) ** -2.0
        for coefficient in reversed(lower):
            folded = folded * cotangent_squared + coefficient
    return folded


@lru_cache
def _folded(order: int) -> Floats:
    """Return the coefficients, in powers of cot^2(w / 2), of the sum over k of (w + 2 pi k)^-2n.

    They follow from d cot(x) / dx = -(1 + cot^2(x)).
    """
    cotangent = np.polynomial.Polynomial([0.0, 1.0])
    for _ in range(2 * order - 1):
        cotangent = np.polynomial.Polynomial([1.0, 0.0, 1.0]) * cotangent.deriv()
    return frozen(cotangent.coef[::2] / (factorial(2 * order - 1) * 4**order))


def returning_power(order: int, damping: float, level_rate: float, angle: Floats) -> Floats:
    """Return the power (k,), unit^2, of a sampled motion with noise of density 1 that returns to its level.

    Parameters
    ----------
    order : int
        n, the number of integrations of the white noise.
    damping : float
        a, cut-off of the low-pass, in radians per step; 0 gives `motion_power`.
    level_rate : float
        b, rate at which the level follows the signal, in radians per step.
    angle : (k,) float array
        w, in radians per step.

    Notes
    -----
    The power is the sum of (w^2 + b^2) / (w^2 (w^2n + a^2n)) over all aliases of w. The nearest aliases are summed one
    by one; the others are summed in closed form, with w^-2n as their power.
    """
    if not damping:
        return motion_power(order, angle)
    from scipy.special import zeta

    turns, near = angle / (2 * np.pi), 2 * np.pi * np.arange(-_FOLDS, _FOLDS + 1)[:, np.newaxis]
    squares = (angle + near) ** 2
    folded = ((1 + level_rate**2 / squares) / (squares**order + damping ** (2 * order))).sum(axis=0)
    beyond = zeta(2 * order, _FOLDS + 1 + turns) + zeta(2 * order, _FOLDS + 1 - turns)
    power: Floats = folded + beyond * (2 * np.pi) ** (-2 * order)
    return power


def autoregressive_power(coefficients: Sequence[float] | Floats, innovation_variance: float, angle: Floats) -> Floats:
    """Return the power (k,), unit^2, of autoregressive noise at angles (k,), in radians per step.

    Parameters
    ----------
    coefficients : (p,) sequence of float
        phi_1 to phi_p of e[k] = sum phi_l e[k-l] + u[k]; empty for white noise.
    innovation_variance : float
        Variance of u, in unit^2; a *small* one means less noise at all frequencies.
    angle : (k,) float array
        Angles in radians per step.

    Notes
    -----
    The power is the variance of u, divided by |1 - sum phi_l exp(-j w l)|^2, with w the angle.
    """
    denominator = np.polyval(np.append(-np.asarray(coefficients)[::-1], 1.0), np.exp(-1j * angle))
    power: Floats = innovation_variance / np.abs(denominator) ** 2
    return power


def butterworth_poles(order: int) -> Complexes:
    """Return the poles (n,) of the Butterworth low-pass with cut-off 1 rad/s, in rad/s."""
    poles: Complexes = np.exp(1j * np.pi * (2 * np.arange(order) + order + 1) / (2 * order))
    return poles


def butterworth_response(order: int, cutoff: float, f: Floats) -> Complexes:
    """Return G (k,) of the digital Butterworth low-pass (bilinear, prewarped); frequencies in cycles per step."""
    s = 1j * np.tan(np.pi * f) / np.tan(np.pi * cutoff)
    response: Complexes = 1 / np.prod(1 - s[:, np.newaxis] / butterworth_poles(order), axis=1)
    return response


def butterworth_delay(order: int, cutoff: float) -> float:
    """Return the delay of `butterworth_response` at low frequency, in steps; the cut-off is in cycles per step."""
    return float(1 / (2 * np.tan(np.pi * cutoff) * np.sin(np.pi / (2 * order))))


def butterworth_noise_gain(order: int, cutoff: float) -> float:
    """Return the share of white noise power that `butterworth_response` passes; the cut-off is in cycles per step.

    Notes
    -----
    With W = tan(pi cutoff) and v = prewarped frequency / prewarped cut-off, the share is
    (2 W / pi) int dv / ((1 + v^2n) (1 + W^2 v^2)) over v > 0. The shares for W and for 1 / W add up to 1: the
    low-pass for 1 / W is the high-pass for W, mirrored about a quarter of the sampling rate, and a low-pass and a
    high-pass with the same W together pass all of the power. As a function of log v the integrand is analytic and
    decays exponentially at both ends, so a plain sum is accurate to nearly all digits.
    """
    W = float(np.tan(np.pi * cutoff))
    if W > 1:
        return 1 - butterworth_noise_gain(order, 0.5 - cutoff)
    v = np.exp(_LOGARITHMS)
    return float(2 * W / np.pi * _LOG_STEP * (v / (1 + v ** (2 * order)) / (1 + (W * v) ** 2)).sum())


class OrderOne(NamedTuple):
    """The steady-state filter of a random walk: a one-pole low-pass."""

    gain: float  # K
    filtered_variance: float  # P+, in units of R
    predicted_variance: float  # P-, in units of R
    innovation_variance: float  # S, in units of R
    noise_gain: float  # variance of white noise after the filter, over its variance before the filter
    delay_steps: float  # delay at low frequency, equal to the lag behind a ramp
    bandwidth: float  # -3 dB, in cycles per step; 0.5 if no frequency is attenuated by 3 dB


def order_one(ratio: float) -> OrderOne:
    """Return the steady-state filter of order 1. Its gain solves K^2 / (1 - K) = q/r; at -3 dB, 4 sin^2(pi f) = q/r."""
    K = float(2 * ratio / (ratio + np.sqrt(ratio**2 + 4 * ratio)))
    bandwidth = np.arcsin(min(1.0, np.sqrt(ratio) / 2)) / np.pi
    return OrderOne(K, K, K / (1 - K), 1 / (1 - K), K / (2 - K), (1 - K) / K, float(bandwidth))
