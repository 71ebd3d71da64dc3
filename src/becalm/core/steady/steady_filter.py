"""A steady-state filter: its frequency response, and the noise gain of filter, fixed lag and smoother.

With the closed loop A = (I - K H) F the frequency response of the filter is G(w) = c (I - A w)^-1 K. Here
w = exp(-j 2 pi f T) is the delay of one step, and c is the row that computes the output from the states, by default H.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Complexes, Floats, frozen, real
from becalm.core.model.covariances import covariance_after
from becalm.core.model.model import Model
from becalm.errors import ModelError

_DOUBLINGS = 80  # largest number of times that a number of steps is doubled


class Loop(NamedTuple):
    """A steady-state filter in scaled states x / sqrt(diag P); the scaling keeps slow filters of high order accurate.

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
        Model of one channel with n states. It has unobservable states only if all of these decay.
    predicted_cov : (n, n) float array
        Prior covariance P.
    gain : (n, 1) float array
        K, the gain of the filtered state.
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
        """Return the output row c (1, n) for the scaled states of `loop`."""
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
        """Return frequencies (k,) above 0 in cycles per step, dense near the poles, where the response changes."""
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
        """Return G of the smoother, of the filter and its correction by later innovations; it is real for c = H."""
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
        """Return the variance of white noise after the filter, over its variance before the filter.

        Parameters
        ----------
        lag_steps : float
            Lag in readings: 0 for the filter, inf for the smoother, any other value for a fixed-lag smoother.
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
        """Return the error variance of the output for a correct model, in unit^2; `lag_steps` as in `noise_gain`."""
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


# The steady-state gain of a filter, from the Riccati equation.

_DECAYS = 1 - 1e-9  # states decay to 0 if the magnitudes of their eigenvalues are below this


def steady(model: Model, output: ArrayLike | None = None) -> SteadyFilter:
    """Return the steady-state filter of a model of one channel, by the doubling form of the Riccati equation.

    Parameters
    ----------
    model : Model
        A model of one channel with n states.
    output : (n,) array_like, optional
        Row that computes the output from the states; H by default.

    Raises
    ------
    ModelError
        If the model has several channels, R = 0 or no steady-state gain, or if the output is invalid or depends on an
        unobservable state.

    Notes
    -----
    Anderson, Int. J. Control 28 (1978) 295: each iteration doubles the number of steps. The method is accurate even for
    the small process noise of high rates, for which eigenvalue methods fail.
    """
    if not isinstance(model, Model):
        raise ModelError(f"A Model is needed; {type(model).__name__} came. Make one: becalm.Model(F=, H=, Q=, R=).")
    if model.channels != 1:
        raise ModelError(f"Only a model of one channel has a response; this model has {model.channels}.")
    R = float(model.R[0, 0])
    if not R > 0:
        raise ModelError("With R = 0 every reading passes unchanged; give a positive R.")
    model, row = _observed_part(model, _output_row(model, output))
    P = _solve_riccati(model, R)
    S = float((model.H @ P @ model.H.T)[0, 0]) + R
    K = P @ model.H.T / S
    return SteadyFilter(model, P, K, (np.eye(model.states) - K @ model.H) @ model.F, S, row)


NEGLIGIBLE_SHARE = 1e-13
"""Largest relative influence on an estimate that counts as none, such as that of rows that have not arrived yet."""


def rows_until_decayed(share: float, model: Model) -> float:
    """Return the number of readings after which the influence of the initial state has fallen to a share.

    Parameters
    ----------
    share : float
        Remaining share, below 1; a *small* one needs more readings.
    model : Model
        A model of one channel, one step per reading.

    Returns
    -------
    float
        Number of readings; inf for a filter without a steady state.
    """
    try:
        radius = float(np.abs(np.linalg.eigvals(steady(model).closed_loop)).max())
    except ModelError:  # no steady state
        return np.inf
    return float(np.log(share) / np.log(max(radius, 1e-300))) if radius < 1.0 else np.inf


def _solve_riccati(model: Model, R: float) -> Floats:
    eye = np.eye(model.states)
    A, G, P = model.F.T.copy(), model.H.T @ model.H / R, model.process_covariance.copy()
    for _ in range(_DOUBLINGS):
        with np.errstate(over="ignore", invalid="ignore"):  # checked just below
            try:
                W = np.linalg.inv(eye + G @ P)
            except np.linalg.LinAlgError as cause:
                raise ModelError(
                    "This model is too slow to compute its steady-state gain in float64; give it a larger Q."
                ) from cause
            A, G, ahead = A @ W @ A, G + A @ W @ G @ A.T, P + A.T @ P @ W @ A
        if not np.isfinite(ahead).all():
            raise ModelError("This model has no steady-state gain: its state grows faster than readings correct it.")
        settled = np.abs(ahead - P).max() <= 1e-15 * np.abs(ahead).max()
        P = (ahead + ahead.T) / 2
        if settled:
            return P
    raise ModelError("This model has no steady-state gain: a state grows and is hardly observed. Leave it out.")


def _output_row(model: Model, output: ArrayLike | None) -> Floats:
    if output is None:
        return model.H
    try:
        row = frozen(np.atleast_2d(np.asarray(real(output), dtype=np.float64)))
    except (TypeError, ValueError) as cause:
        raise ModelError(f"output is not a row of numbers ({cause}); give {model.states}, one per state.") from cause
    if row.shape != (1, model.states):
        raise ModelError(f"output has shape {np.shape(output)}; give {model.states} numbers, one per state.")
    if not np.isfinite(row).all() or not row.any():
        raise ModelError(f"output = {row[0].tolist()} makes no output; give finite numbers, not all of them 0.")
    return row


def _observed_part(model: Model, row: Floats) -> tuple[Model, Floats]:
    """Return model and output row without the unobservable directions; if all of these decay to 0, keep them."""
    hidden = model.unobservable
    if not hidden.shape[1] or np.abs(np.linalg.eigvals(hidden.T @ model.F @ hidden)).max() < _DECAYS:
        return model, row
    if np.abs(row @ hidden).max() > 1e-9 * np.abs(row).max():
        raise ModelError("The output depends on a state that no reading determines; use observed states only.")
    if hidden.shape[1] == model.states:
        raise ModelError("H is 0, so no reading depends on the state; give H at least one number that is not 0.")
    observed = np.linalg.svd(hidden)[0][:, hidden.shape[1] :]
    Q = observed.T @ model.process_covariance @ observed
    return Model(F=observed.T @ model.F @ observed, H=model.H @ observed, Q=(Q + Q.T) / 2, R=model.R), row @ observed
