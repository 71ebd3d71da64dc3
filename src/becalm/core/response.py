"""What a tuned filter is, in an engineer's words: bandwidth, lag and noise left.

For one channel of a model whose gain settles. With the closed loop A = (I - K H) F the filter is
G(w) = H (I - A w)^-1 K, where w = exp(-j 2 pi f T) is one step's delay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_lyapunov
from scipy.optimize import brentq

from becalm.core.arrays import Floats
from becalm.core.model import Model
from becalm.errors import ModelError

_DOUBLINGS = 80
_GRID = np.concatenate([np.geomspace(1e-9, 1e-3, 1200), np.linspace(1e-3, 0.5, 1200)[1:]])


@dataclass(frozen=True)
class Response:
    """A steady filter of one channel.

    Attributes
    ----------
    bandwidth_hz : float
        Highest frequency that still passes with half of its power (-3 dB); half the rate if all pass.
    lag_s : float
        Delay of a slow signal (group delay at 0 Hz), in seconds; 0 for a smoother.
    noise_gain : float
        Variance of white noise after the filter over before.
    """

    bandwidth_hz: float
    lag_s: float
    noise_gain: float


@dataclass(frozen=True)
class SteadyFilter:
    """A filter whose gain has settled.

    Attributes
    ----------
    model : Model
        One channel, n states.
    predicted_cov : (n, n) float array
        P before the update.
    gain : (n, 1) float array
        K, of the filtered form.
    closed_loop : (n, n) float array
        (I - K H) F.
    innovation_variance : float
        S, in unit^2.
    """

    model: Model
    predicted_cov: Floats
    gain: Floats
    closed_loop: Floats
    innovation_variance: float

    def filter_power(self, cycles_per_step: Floats) -> Floats:
        """Return |G|^2 of the filter at frequencies in cycles a step, (k,)."""
        result: Floats = np.abs((self.model.H @ self._states(cycles_per_step))[:, 0, 0]) ** 2
        return result

    def smoother_power(self, cycles_per_step: Floats) -> Floats:
        """Return |G|^2 of the smoother, G = 1 - R |W|^2 / S with W whitening the readings."""
        delay = np.exp(-2j * np.pi * cycles_per_step)
        whitening = 1 - delay * (self.model.H @ self.model.F @ self._states(cycles_per_step))[:, 0, 0]
        result: Floats = (1 - self.model.R[0, 0] * np.abs(whitening) ** 2 / self.innovation_variance) ** 2
        return result

    def _states(self, cycles_per_step: Floats) -> Floats:
        """Return (I - A w)^-1 K for each frequency, (k, n, 1), complex."""
        delay = np.exp(-2j * np.pi * cycles_per_step)[:, np.newaxis, np.newaxis]
        solved: Floats = np.linalg.solve(np.eye(self.model.states) - self.closed_loop * delay, self.gain[np.newaxis])
        return solved


def steady(model: Model) -> SteadyFilter:
    """Settle the gain of a one-channel model, by the doubling form of the Riccati equation.

    Raises
    ------
    ModelError
        If the model has several channels, R = 0, or no steady gain.

    Notes
    -----
    Anderson, Int. J. Control 28 (1978) 295: each pass doubles the number of steps, and the small
    process noise of high rates, where eigenvalue methods fail, does it no harm.
    """
    if model.channels != 1:
        raise ModelError(f"A response is told of one channel; this model has {model.channels}.")
    R = float(model.R[0, 0])
    if not R > 0:
        raise ModelError("With R = 0 every reading passes unchanged; give a positive R.")
    eye = np.eye(model.states)
    A, G, P = model.F.T.copy(), model.H.T @ model.H / R, model.process_covariance.copy()
    for _ in range(_DOUBLINGS):
        with np.errstate(over="ignore", invalid="ignore"):  # refused just below
            W = np.linalg.inv(eye + G @ P)
            A, G, ahead = A @ W @ A, G + A @ W @ G @ A.T, P + A.T @ P @ W @ A
        if not np.isfinite(ahead).all():
            raise ModelError("This model has no steady gain; some state is never observed and grows.")
        settled = np.abs(ahead - P).max() <= 1e-15 * np.abs(ahead).max()
        P = (ahead + ahead.T) / 2
        if settled:
            break
    else:
        raise ModelError("This model has no steady gain; some state is never observed and grows. Leave it out.")
    S = float((model.H @ P @ model.H.T)[0, 0]) + R
    K = P @ model.H.T / S
    return SteadyFilter(model, P, K, (eye - K @ model.H) @ model.F, S)


def describe(model: Model, step_s: float, causal: bool = True) -> Response:
    """Describe the steady filter, or the smoother, of a one-channel model.

    Parameters
    ----------
    model : Model
        One channel, any states.
    step_s : float
        Step in seconds.
    causal : bool
        Whether to describe the filter (True) or the smoother.

    Raises
    ------
    ModelError
        If the model has several channels, R = 0, or no steady gain.
    """
    loop = steady(model)
    power = loop.filter_power if causal else loop.smoother_power
    bandwidth = _last_crossing(power) / step_s
    if not causal:
        return Response(bandwidth, 0.0, 2 * float(np.trapezoid(power(_GRID), _GRID)))
    A, K, H = loop.closed_loop, loop.gain, model.H
    rest = np.linalg.inv(np.eye(model.states) - A)
    lag = float((H @ rest @ A @ rest @ K / (H @ rest @ K))[0, 0])
    noise_gain = float((H @ solve_discrete_lyapunov(A, K @ K.T) @ H.T)[0, 0])
    return Response(bandwidth, lag * step_s, noise_gain)


def _last_crossing(power: Callable[[Floats], Floats]) -> float:
    """Find the highest frequency, in cycles a step, at which half of the power passes."""
    passes = power(_GRID) > 0.5
    if passes[-1]:
        return 0.5
    if not passes.any():
        return 0.0
    last = int(np.flatnonzero(passes)[-1])
    return float(brentq(lambda f: float(power(np.array([f]))[0]) - 0.5, _GRID[last], _GRID[last + 1], xtol=1e-15))
