"""Closed forms: steady filters of motions, their limit as the rate grows, and their spectrum.

All in steps and with r = 1: variances are in units of a reading's. q/r counts as in `Tuning.ratio`, with
the density q of the noise on the n-th derivative in unit^2/step^(2n-1).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Complexes, Floats, frozen

_FINE = 0.05  # between logarithms of frequencies
_FOLDS = 16  # frequencies on each side
_LOGARITHMS = np.arange(-40.0, 40.0, _FINE)


def cutoff_to_ratio(order: int, cutoff: float) -> float:
    """Return q/r of the motion filter with its cut-off w_n in radians a step, w_n^2n (motion's Notes, with T = 1)."""
    return float(cutoff ** (2 * order))


def ratio_to_cutoff(order: int, ratio: float) -> float:
    """Return the cut-off in radians a step of the motion filter with q/r: the inverse of `cutoff_to_ratio`."""
    return float(ratio ** (1 / (2 * order)))


def motion_power(order: int, angle: Floats) -> Floats:
    """Return the power (k,), unit^2, of a motion of density 1 at angles (k,) in radians a step, read once a step.

    Notes
    -----
    White noise integrated `order` times has the power w^-2n; reading it once a step folds all
    frequencies w + 2 pi k onto w. As the sum of 1 / (x + k) is pi cot(pi x), that of powers is a derivative of it, a
    polynomial in the cotangent. The smoother passes G = S / (S + R) of a motion with the power S.
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
    """Return the sum over k of (w + 2 pi k)^-2n by powers of cot^2(w / 2): d cot(x) / dx = -(1 + cot^2(x))."""
    cotangent = np.polynomial.Polynomial([0.0, 1.0])
    for _ in range(2 * order - 1):
        cotangent = np.polynomial.Polynomial([1.0, 0.0, 1.0]) * cotangent.deriv()
    return frozen(cotangent.coef[::2] / (factorial(2 * order - 1) * 4**order))


def returning_power(order: int, damping: float, level_rate: float, angle: Floats) -> Floats:
    """Return the power (k,), unit^2, of a motion of density 1 that returns to its level, read once a step.

    Parameters
    ----------
    order : int
        n, how often white noise is integrated.
    damping : float
        a, cut-off of the low-pass, radians a step; 0 is `motion_power`.
    level_rate : float
        b, how fast the level follows, radians a step.
    angle : (k,) float array
        w, radians a step.

    Notes
    -----
    The power (w^2 + b^2) / (w^2 (w^2n + a^2n)), folded: the next frequencies one by one, those beyond as if there
    were no damping.
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
    """Return the power (k,), unit^2, of autoregressive noise at angles (k,) in radians a step.

    Parameters
    ----------
    coefficients : (p,) sequence of float
        phi_1 to phi_p of e[k] = sum phi_i e[k-i] + w[k]; none of white noise.
    innovation_variance : float
        Variance of w, in unit^2; with a *small* one there is less noise everywhere.
    angle : (k,) float array
        In radians a step.

    Notes
    -----
    Its power is that of w over |1 - sum phi_l exp(-i w l)|^2.
    """
    late = np.arange(1, len(coefficients) + 1)
    left = 1 - np.exp(-1j * np.outer(angle, late)) @ np.asarray(coefficients)
    power: Floats = innovation_variance / np.abs(left) ** 2
    return power


def butterworth_poles(order: int) -> Complexes:
    """Return the poles (n,) of the Butterworth low-pass with its cut-off at 1 rad/s, in rad/s."""
    poles: Complexes = np.exp(1j * np.pi * (2 * np.arange(order) + order + 1) / (2 * order))
    return poles


def butterworth_response(order: int, cutoff: float, f: Floats) -> Complexes:
    """Return G (k,) of the digital Butterworth low-pass (bilinear, prewarped), all in cycles a step."""
    s = 1j * np.tan(np.pi * f) / np.tan(np.pi * cutoff)
    response: Complexes = 1 / np.prod(1 - s[:, np.newaxis] / butterworth_poles(order), axis=1)
    return response


def butterworth_delay(order: int, cutoff: float) -> float:
    """Return the delay of a slow signal, in steps, by `butterworth_response`; its cut-off in cycles a step."""
    return float(1 / (2 * np.tan(np.pi * cutoff) * np.sin(np.pi / (2 * order))))


def butterworth_noise_gain(order: int, cutoff: float) -> float:
    """Return the share of the power of white noise that `butterworth_response` leaves; its cut-off in cycles a step.

    Notes
    -----
    With W = tan(pi cutoff) and the frequency v over the prewarped cut-off it is
    (2 W / pi) int dv / ((1 + v^2n) (1 + W^2 v^2)) over v > 0. What passes at W and at 1 / W adds up to 1: as
    the low-pass at one is the high-pass at the other, mirrored about a quarter of the rate. Over log v the
    integrand is analytic and falls off exponentially at both ends, so that a plain sum has nearly all digits.
    """
    W = float(np.tan(np.pi * cutoff))
    if W > 1:
        return 1 - butterworth_noise_gain(order, 0.5 - cutoff)
    v = np.exp(_LOGARITHMS)
    return float(2 * W / np.pi * _FINE * (v / (1 + v ** (2 * order)) / (1 + (W * v) ** 2)).sum())


class OrderOne(NamedTuple):
    """The steady filter of a random walk: a one-pole low-pass."""

    gain: float  # K
    filtered_variance: float  # P+
    predicted_variance: float  # P-
    innovation_variance: float  # S
    noise_gain: float
    delay_steps: float  # of a slow signal, and behind a ramp
    bandwidth: float  # -3 dB, in cycles a step; 0.5 where all pass


def order_one(ratio: float) -> OrderOne:
    """Return the closed form of order 1 for q/r; K^2 / (1 - K) = q/r, and q/r = 4 sin^2(pi f T) at -3 dB."""
    K = float(2 * ratio / (ratio + np.sqrt(ratio**2 + 4 * ratio)))
    bandwidth = np.arcsin(min(1.0, np.sqrt(ratio) / 2)) / np.pi
    return OrderOne(K, K, K / (1 - K), 1 / (1 - K), K / (2 - K), (1 - K) / K, float(bandwidth))
