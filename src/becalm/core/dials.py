"""Closed forms of steady filters, and the dials: the ratio q/r that gives a bandwidth, a lag or a noise gain.

All in steps and with r = 1: variances are in units of a reading's. q/r counts as in `Tuning.ratio`, with
the density q of the noise on the n-th derivative in unit^2/step^(2n-1).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from becalm.core.arrays import Floats
from becalm.core.components import HIGHEST_ORDER, motion
from becalm.core.response import decibels, describe, lag_steps
from becalm.core.steady import Complexes, SteadyFilter, steady
from becalm.errors import ModelError, UsageError

_SLOWEST = {1: 1e-6, 2: 1e-6, 3: 3e-6, 4: 1e-4, 5: 1e-4}  # cut-off in radians a step: below, rounding decides
_FASTEST = 1e12  # q/r: above, every reading is believed
_PRECISION = 1e-12  # of the logarithm of the cut-off


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
        """Of the level."""
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
        """Of the level."""
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
    p = np.exp(1j * np.pi * (2 * np.arange(n) + n + 1) / (2 * n))
    variance = 1 / np.sin(np.pi / (2 * n))
    gains = np.poly(p).real[1:].astype(np.float64)
    return ContinuousMotion(gains, variance * (2 * n - 1) / (4 * n), variance, variance / (2 * n), p)


def motion_filter(order: int, ratio: float) -> SteadyFilter:
    """Return the steady filter of a motion with step 1 and r = 1."""
    return steady(motion(order, ratio).to_model(1.0, 1.0))


def ratio_for_bandwidth(order: int, bandwidth_hz: float, step_s: float) -> float:
    """Return the q/r of a motion whose causal filter has a -3 dB bandwidth.

    Parameters
    ----------
    order : int
        1 to 5.
    bandwidth_hz : float
        Highest frequency that passes with half of its power, below half the rate; a *small* one smooths more.
    step_s : float
        Step in seconds.

    Raises
    ------
    UsageError
        If no filter of this order has it; the sentence says which are possible.
    """
    cycles = cycles_per_step(bandwidth_hz, step_s)
    ratio = float(4 * np.sin(np.pi * cycles) ** 2)
    if order == 1 and ratio >= _SLOWEST[1] ** 2:
        return ratio
    return _solve(
        order,
        f"bandwidth_hz = {bandwidth_hz}",
        lambda found: float(found.filter_power([cycles])[0]) - 0.5,
        lambda found: describe(found.model, step_s).bandwidth_hz,
    )


def cycles_per_step(bandwidth_hz: float, step_s: float) -> float:
    """Return a bandwidth in cycles a step.

    Raises
    ------
    UsageError
        If it is not between 0 and half the rate.
    """
    cycles = bandwidth_hz * step_s
    if not 0 < cycles < 0.5:
        raise UsageError(
            f"bandwidth_hz = {bandwidth_hz:.6g} is not possible at {1 / step_s:.6g} Hz;"
            f" ask for more than 0 and less than {0.5 / step_s:.6g} Hz, half the rate."
        )
    return cycles


def ratio_for_lag(order: int, lag_s: float, step_s: float) -> float:
    """Return the q/r of a motion whose causal filter trails by a lag.

    Parameters
    ----------
    order : int
        1 to 5.
    lag_s : float
        Of the output behind its input, drawn as lines: of a slow ramp, or of a step at half of its
        height, whichever is longer. So neither ramp nor edge comes later than this. (The first
        alone would be 0 from order 2 on, although an edge comes late.) For order 1 it is the ramp:
        (1 - K) / K steps. A *small* one trusts the readings and smooths less.
    step_s : float
        Step in seconds.

    Raises
    ------
    UsageError
        If no filter of this order has it; the sentence says which are possible.
    """
    steps = lag_s / step_s
    if not 0 < steps < np.inf:
        raise UsageError(f"lag_s = {lag_s} is not possible; give a positive number of seconds: 0 would filter nothing.")
    return _solve(
        order,
        f"lag_s = {lag_s}",
        lambda found: steps - lag_steps(found),
        lambda found: lag_steps(found) * step_s,
    )


def ratio_for_noise_gain(order: int, noise_gain_db: float) -> float:
    """Return the q/r of a motion whose causal filter leaves so much white noise.

    Parameters
    ----------
    order : int
        1 to 5.
    noise_gain_db : float
        Noise power after the filter over before, in dB, so below 0; a *small* one (-40) smooths more.

    Raises
    ------
    UsageError
        If no filter of this order has it; the sentence says which are possible.
    """
    if not noise_gain_db < 0:
        raise UsageError(
            f"noise_gain_db = {noise_gain_db} removes no noise; for noise down by 14 dB give noise_gain_db = -14."
        )
    wanted = 10 ** (noise_gain_db / 10)
    K = 2 * wanted / (1 + wanted)
    if order == 1 and _SLOWEST[1] <= K < 1:
        return float(K**2 / (1 - K))
    return _solve(
        order,
        f"noise_gain_db = {noise_gain_db}",
        lambda found: found.noise_gain() - wanted,
        lambda found: decibels(found.noise_gain()),
    )


def _solve(
    order: int, asked: str, excess: Callable[[SteadyFilter], float], told: Callable[[SteadyFilter], float]
) -> float:
    """Find q/r where an excess, which grows with it, is 0; `told` is what was asked for, in its unit."""
    if order not in range(1, HIGHEST_ORDER + 1):
        raise ModelError(f"order = {order} is not offered; choose 1 (level) to {HIGHEST_ORDER}.")
    low, high = np.log(_SLOWEST[order]), np.log(_FASTEST) / (2 * order)

    def at(log_cutoff: float) -> SteadyFilter:
        return motion_filter(order, float(np.exp(2 * order * log_cutoff)))

    if excess(at(low)) > 0 or excess(at(high)) < 0:
        possible = sorted(told(at(bound)) for bound in (low, high))
        raise UsageError(f"{asked} is not possible with order {order}; ask for {possible[0]:.3g} to {possible[1]:.3g}.")
    found = brentq(lambda x: excess(at(x)), low, high, xtol=_PRECISION, rtol=_PRECISION)
    return float(np.exp(2 * order * found))
