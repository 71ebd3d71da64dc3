"""Closed forms of the gains of trackers, and of motions whose rate grows without end: oracles of steady filters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Complexes, Floats
from becalm.core.closed_forms import butterworth_poles


class AlphaBeta(NamedTuple):
    """The steady filter of a walking slope; its gains are alpha and beta / T."""

    alpha: float
    beta: float

    @property
    def filtered_cov(self) -> Floats:
        """P+ for T = 1, (2, 2); of piecewise constant acceleration only."""
        a, b = self
        return np.array([[a, b], [b, b * (a - b / 2) / (1 - a)]])

    @property
    def noise_gain(self) -> float:
        """Variance of white noise in the level after the filter over before."""
        a, b = self
        return (2 * a**2 + 2 * b - 3 * a * b) / (a * (4 - 2 * a - b))


def alpha_beta(index: float) -> AlphaBeta:
    """Return Kalata's gains for acceleration that is constant over each step (IEEE TAES-20, 1984, 174).

    Parameters
    ----------
    index : float
        Tracking index sigma_a T^2 / sigma_v; a *small* one trusts the slope and smooths more.
    """
    fall = (np.sqrt(8 * index + index**2) - index) / 4  # 1 - root, without cancellation
    return AlphaBeta(float(fall * (2 - fall)), float(2 * fall**2))


def alpha_beta_continuous(ratio: float) -> AlphaBeta:
    """Return the gains for continuous white acceleration: motion of order 2, of q/r.

    Notes
    -----
    With u = 2 - z - 1/z and L^2 = q/r the second differences of the readings have the spectrum
    u^2 + L^2 (1 - u / 6), which is 0 at the closed loop's poles z; 1 - alpha is their product, and
    beta^2 = L^2 (1 - alpha). Bar-Shalom, Li and Kirubarajan (2001), ch. 6.
    """
    u = np.roots([1.0, -ratio / 6, ratio]).astype(complex)
    half, root = 1 - u / 2, np.sqrt(-u / 2) * np.sqrt(2 - u / 2)  # half = (z + 1/z) / 2
    z = np.where(np.abs(half - root) < 1, half - root, half + root)
    kept = float(np.prod(z).real)
    return AlphaBeta(1 - kept, float(np.sqrt(ratio * kept)))


class AlphaBetaGamma(NamedTuple):
    """The steady filter of a walking acceleration; its gains are alpha, beta / T and gamma / (2 T^2).

    Mind the two: others write the third gain as g / T^2, so that g = gamma / 2; `noise_gain` knows.
    """

    alpha: float
    beta: float
    gamma: float

    @property
    def noise_gain(self) -> float:
        """Variance of white noise in the level after the filter over before."""
        a, b, g = self.alpha, self.beta, self.gamma / 2
        above = 2 * b * (2 * a**2 + 2 * b - 3 * a * b) - a * g * (4 - 2 * a - b)
        return above / ((4 - 2 * a - b) * (2 * a * b + a * g - 2 * g))


def alpha_beta_gamma(index: float) -> AlphaBetaGamma:
    """Return Kalata's gains for acceleration that steps at each reading; see `alpha_beta` for the index.

    Notes
    -----
    With p = 1 - sqrt(1 - alpha): beta = 2 p^2, gamma = beta^2 / alpha, and L^2 = gamma^2 / (4 (1 - alpha))
    becomes a cubic in p.
    """
    roots = np.roots([2.0, -index, 3 * index, -2 * index])
    p = float(roots[np.argmin(np.abs(roots.imag))].real)
    alpha, beta = p * (2 - p), 2 * p**2
    return AlphaBetaGamma(alpha, beta, beta**2 / alpha)


class ContinuousMotion(NamedTuple):
    """The filter of n-th order motion as the rate grows, for a cut-off of 1 rad/s and r_c = R T = 1.

    Its poles are those of a Butterworth low-pass; H(s) = (D(s) - s^n) / D(s).
    """

    gains: Floats  # (n,), of the innovation into each state
    noise_bandwidth_hz: float  # one-sided
    filtered_variance: float
    smoothed_variance: float
    poles: Complexes  # (n,), rad/s

    def power(self, frequency: Floats) -> Floats:
        """Return |H|^2 at frequencies (k,) in rad/s."""
        s = 1j * frequency
        left = s[:, np.newaxis] / (s[:, np.newaxis] - self.poles)
        result: Floats = np.abs(1 - np.prod(left, axis=1)) ** 2
        return result

    def step(self, time: Floats) -> Floats:
        """Return the response (k,) to a step at times in s: 1 - sum of p^(n-1) / D'(p) exp(p t)."""
        p = self.poles
        slopes = [np.prod(pole - np.delete(p, k)) for k, pole in enumerate(p)]
        result: Floats = 1 - (np.exp(np.outer(time, p)) @ (p ** (len(p) - 1) / slopes)).real
        return result


def continuous_motion(order: int) -> ContinuousMotion:
    """Return the continuous limit of motion of any order; a cut-off w_n multiplies what is per second."""
    n = order
    p = butterworth_poles(n)
    variance = 1 / np.sin(np.pi / (2 * n))
    gains = np.poly(p).real[1:].astype(np.float64)
    return ContinuousMotion(gains, variance * (2 * n - 1) / (4 * n), variance, variance / (2 * n), p)
