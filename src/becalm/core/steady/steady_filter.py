"""A steady-state filter: its frequency response, and the noise gain of filter, fixed lag and smoother.

With the closed loop A = (I - K H) F the filter is G(w) = c (I - A w)^-1 K, where w = exp(-j 2 pi f T) is the
delay of one step and c the row that computes the output from the states, H by default.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Complexes, Floats
from becalm.core.model.covariances import covariance_after
from becalm.core.model.model import Model

_DOUBLINGS = 80


class Loop(NamedTuple):
    """A steady-state filter in scaled states x / sqrt(diag P), which keep slow filters of high order accurate.

    P+ is the covariance after the update; M = F (I - K H) is the transition matrix of the prediction error.
    """

    F: Floats
    H: Floats
    K: Floats
    A: Floats
    M: Floats
    P_plus: Floats


@dataclass(frozen=True)
class SteadyFilter:
    """A filter with its steady-state gain.

    Attributes
    ----------
    model : Model
        Model of one channel with n states, without unobservable states that grow.
    predicted_cov : (n, n) float array
        Prior covariance P.
    gain : (n, 1) float array
        K, the gain of the filtered form.
    closed_loop : (n, n) float array
        (I - K H) F.
    innovation_variance : float
        S, in unit^2.
    output : (1, n) float array
        c, the row that computes the output from the states.
    """

    model: Model
    predicted_cov: Floats
    gain: Floats
    closed_loop: Floats
    innovation_variance: float
    output: Floats

    @cached_property
    def loop(self) -> Loop:
        """Return the same filter in scaled states."""
        D = self._scale
        F, H, K = self.model.F / D[:, np.newaxis] * D, self.model.H * D, self.gain / D[:, np.newaxis]
        I_KH = np.eye(len(F)) - K @ H
        P_plus = covariance_after(self.predicted_cov, self.gain, self.model) / np.outer(D, D)
        return Loop(F, H, K, I_KH @ F, F @ I_KH, P_plus)

    @cached_property
    def row(self) -> Floats:
        """Return the row c for the states of `loop`, (1, n)."""
        scaled: Floats = self.output * self._scale
        return scaled

    @cached_property
    def _scale(self) -> Floats:
        spread = np.sqrt(np.maximum(np.diag(self.predicted_cov), 0.0))
        return np.where(spread > 0, spread, 1.0)

    @cached_property
    def poles(self) -> Complexes:
        """Return the eigenvalues of the closed loop, (n,), the slowest first."""
        poles = np.linalg.eigvals(self.loop.A).astype(np.complex128)
        return poles[np.argsort(-np.abs(poles), kind="stable")]

    @property
    def dc_gain(self) -> float:
        """Return the gain at 0 Hz; 1 if the signal of the model can be constant."""
        A, K = self.loop.A, self.loop.K
        return float((self.row @ np.linalg.solve(np.eye(len(A)) - A, K))[0, 0])

    @property
    def dc_delay(self) -> float:
        """Return the group delay at 0 Hz, in steps: w dG/dw over G at w = 1."""
        A, K, c = self.loop.A, self.loop.K, self.row
        inverse = np.linalg.inv(np.eye(len(A)) - A)
        return float((c @ inverse @ A @ inverse @ K / (c @ inverse @ K))[0, 0])

    @cached_property
    def frequencies(self) -> Floats:
        """Return frequencies (k,) above 0 in cycles per step, dense where the response changes near a pole."""
        centres, widths = np.angle(self.poles) / (2 * np.pi), (1 - np.abs(self.poles)) / (2 * np.pi)
        slowest = float(np.abs(1 - self.poles).min()) / (2 * np.pi)
        near = np.geomspace(1e-2, 1e2, 60)
        around = [f + side * near * width for f, width in zip(centres, widths, strict=True) for side in (-1, 1)]
        f = np.concatenate([np.geomspace(1e-3 * slowest, 0.5, 800), np.linspace(0, 0.5, 801), *around])
        return np.unique(f[(f >= 1e-3 * slowest) & (f <= 0.5)])

    def filter_response(self, cycles_per_step: ArrayLike) -> Complexes:
        """Return G of the filter at frequencies (k,) in cycles per step."""
        response: Complexes = (self.row @ self._states(_delay(cycles_per_step)))[:, 0, 0]
        return response

    def smoother_response(self, cycles_per_step: ArrayLike) -> Complexes:
        """Return G of the smoother: the filter plus the correction by later innovations; real for c = H."""
        delay, loop = _delay(cycles_per_step), self.loop
        states = self._states(delay)
        whitening = 1 - delay * (loop.H @ loop.F @ states)[:, 0, 0]
        ahead = loop.M.T[np.newaxis] / delay[:, np.newaxis, np.newaxis]
        later = np.linalg.solve(np.eye(len(loop.F)) - ahead, loop.H.T / self.innovation_variance)
        correction = (self.row @ loop.P_plus @ loop.F.T @ later)[:, 0, 0]
        response: Complexes = (self.row @ states)[:, 0, 0] + correction * whitening / delay
        return response

    def filter_power(self, cycles_per_step: ArrayLike) -> Floats:
        """Return |G|^2 (k,) of the filter at frequencies (k,) in cycles per step."""
        result: Floats = np.abs(self.filter_response(cycles_per_step)) ** 2
        return result

    def smoother_power(self, cycles_per_step: ArrayLike) -> Floats:
        """Return |G|^2 (k,) of the smoother at frequencies (k,) in cycles per step."""
        result: Floats = np.abs(self.smoother_response(cycles_per_step)) ** 2
        return result

    def noise_gain(self, lag_steps: float = 0) -> float:
        """Return the variance of white noise after the filter over that before.

        Parameters
        ----------
        lag_steps : float
            Lag in readings: 0 is the filter, inf the smoother, other values a fixed-lag smoother.
        """
        c, loop = self.row, self.loop
        if lag_steps == 0:
            return float((c @ self._noise @ c.T)[0, 0])
        M, K, N = loop.M, loop.F @ loop.K, self._future
        u = c @ loop.P_plus @ loop.F.T
        b = loop.H.T / self.innovation_variance - M.T @ N @ K
        far = _power(M, lag_steps)
        within_lag = N - far.T @ N @ far  # information of the readings within the lag
        past = c - u @ within_lag @ loop.F
        future, remote = _summed(M.T, b @ b.T), _summed(M, K @ K.T)
        d = u @ far.T @ N
        variance = past @ self._noise @ past.T + u @ (future - far.T @ future @ far) @ u.T
        if np.isfinite(lag_steps):
            both = np.block([[M.T, b @ d], [np.zeros_like(M), M]])
            cross = _power(both, lag_steps)[: len(M), len(M) :]
            variance = variance + d @ (remote - far @ remote @ far.T) @ d.T + 2 * u @ cross @ K
        return float(variance[0, 0])

    def error_variance(self, lag_steps: float = 0) -> float:
        """Return the error variance of the output if the model is correct, in unit^2; `lag_steps` as above."""
        c, loop = self.row, self.loop
        far = _power(loop.M, lag_steps)
        u = c @ loop.P_plus @ loop.F.T
        reduction = u @ (self._future - far.T @ self._future @ far) @ u.T
        return float((c @ loop.P_plus @ c.T - reduction)[0, 0])

    @cached_property
    def _noise(self) -> Floats:
        """Return the covariance of the states of `loop` for white noise of variance 1 as input."""
        return _summed(self.loop.A, self.loop.K @ self.loop.K.T)

    @cached_property
    def _future(self) -> Floats:
        """Return the information N of all later readings on the prediction error: the sum of M'^i H' S^-1 H M^i."""
        return _summed(self.loop.M.T, self.loop.H.T @ self.loop.H / self.innovation_variance)

    def _states(self, delay: Complexes) -> Complexes:
        """Return (I - A w)^-1 K for each w, (k, n, 1)."""
        A, K = self.loop.A, self.loop.K
        each = np.eye(len(A)) - A * delay[:, np.newaxis, np.newaxis]
        return np.linalg.solve(each, K[np.newaxis]).astype(np.complex128)


def _delay(cycles_per_step: ArrayLike) -> Complexes:
    delay: Complexes = np.exp(-2j * np.pi * np.asarray(cycles_per_step, dtype=np.float64))
    return delay


def _power(M: Floats, steps: float) -> Floats:
    """Return M to the power of a number of steps; 0 for infinitely many steps, because M is stable."""
    return np.linalg.matrix_power(M, int(steps)) if np.isfinite(steps) else np.zeros_like(M)


def _summed(M: Floats, B: Floats) -> Floats:
    """Return the sum of M^i B M'^i over all i, by doubling."""
    total = B
    for _ in range(_DOUBLINGS):
        more = M @ total @ M.T
        total, M = total + more, M @ M
        if np.abs(more).max() <= 1e-17 * np.abs(total).max():
            break
    return total
