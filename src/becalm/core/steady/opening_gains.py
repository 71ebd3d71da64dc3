"""The gains of a causal filter of one channel, computed in advance: from a flat prior to the steady state.

The gains do not depend on the readings. A filter without missing readings is therefore fully described by these
numbers: the weights of the first readings, which determine the state; a gain for each later row; the steady-state gain.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.covariances import covariance_after, covariance_ahead
from becalm.core.model.model import Model
from becalm.core.model.prior import flat_prior, refuse_singular, root_of
from becalm.core.model.step_matrices import model_system
from becalm.errors import ModelError

_LONGEST_OPENING = 4096  # largest number of readings
_WELL_DETERMINED, _LIVE = 1e-6, 3e-5  # same values as in native/opening.h
_UNCHANGED = 1e-13  # largest change of a gain over the last eighth of the rows, relative to the gain plus sqrt(P / R)
_FIRST_CHECK = 32  # number of rows before the gain may count as settled


class Opening(NamedTuple):
    """State and covariance after the first readings that determine the state; none of these readings is missing."""

    weights: Floats  # (o, n): the state after o readings z is weights.T @ z
    P: Floats  # (n, n) its covariance, in unit^2


def determine_state(model: Model) -> Opening:
    """Return the state of a model of one channel as a function of its first readings.

    Parameters
    ----------
    model : Model
        A model of one channel, one step per reading, without x0 and P0.

    Raises
    ------
    ModelError
        If F or R has no inverse, or 4096 readings do not determine the state.

    Notes
    -----
    Square root information filter (Bierman 1977, chapter V): U x = b + e with e ~ N(0, I). The right-hand side b is
    linear in the readings; each equation stores the weights of the readings in b.
    """
    refuse_singular(model_system(model))
    n = model.states
    prior = np.pad(root_of(flat_prior(model).Y), ((0, 0), (0, 1)))
    noise, reading = root_of(model.process_covariance).T, np.append(model.H[0], 1.0) / np.sqrt(model.R[0, 0])
    equations = _triangular(np.vstack([prior, reading]), n)
    while not _is_determined(equations[:, :n]):
        if equations.shape[1] - n == _LONGEST_OPENING:
            raise ModelError(f"{_LONGEST_OPENING} readings do not determine the state of this model; leave a tone out.")
        added = np.hstack([reading[:n], np.zeros(equations.shape[1] - n), reading[n:]])
        equations = np.pad(_predicted(equations, model.F, noise, prior), ((0, 0), (0, 1)))
        equations = _triangular(np.vstack([equations, added]), n)
    inverse = np.linalg.inv(equations[:, :n])
    return Opening((inverse @ equations[:, n:]).T, inverse @ inverse.T)


def _is_determined(U: Floats) -> bool:
    """Return whether a root U of information determines the state, as `try_to_determine` in `native/opening.h`."""
    length = np.linalg.norm(U, axis=0)
    if (np.abs(np.diag(U)) <= _LIVE * length).any():
        return False
    return bool(_WELL_DETERMINED * np.sum((np.linalg.inv(U) * length[:, np.newaxis]) ** 2) < 1)


def _triangular(equations: Floats, n: int) -> Floats:
    """Return equations (r, n + o) of n states, reduced to n rows with an upper triangular U."""
    return np.asarray(np.linalg.qr(equations, mode="r")[:n], dtype=np.float64)


def _predicted(equations: Floats, F: Floats, noise: Floats, prior: Floats) -> Floats:
    """Predict equations (n, n + o) by one step; if F has no inverse, return those of the prior."""
    n = len(F)
    try:
        W = equations[:, :n] @ np.linalg.inv(F)
    except np.linalg.LinAlgError:  # damped states underflow to 0 over a very long step
        return np.pad(prior[:, :n], ((0, 0), (0, equations.shape[1] - n)))
    first = np.hstack([np.eye(n), np.zeros_like(equations)])
    second = np.hstack([-W @ noise, W, equations[:, n:]])
    return _triangular(np.vstack([first, second]), 2 * n)[n:, n:]


class Gains(NamedTuple):
    """The gains of the rows after an opening."""

    K: Floats  # (r, n) gains; the last gain is the steady-state gain if `settled`
    settled: bool


def gains_after(opening: Opening, model: Model, most: int) -> Gains:
    """Return the gains of the rows after an opening up to the steady state (equations of `core/reference/kalman.py`).

    Parameters
    ----------
    opening : Opening
        State and covariance after the first readings, for the same model.
    model : Model
        A model of one channel, one step per reading.
    most : int
        Largest number of gains.
    """
    h, R = model.H[0], float(model.R[0, 0])
    P, unchanged_rows = opening.P, 0
    gains: list[Floats] = []
    while len(gains) < most and unchanged_rows <= model.states:
        P = covariance_ahead(P, model)
        Ph = P @ h
        K = Ph / (h @ Ph + R)  # (4), (5)
        P = covariance_after(P, K[:, np.newaxis], model)
        gains.append(K)
        earlier = gains[len(gains) * 7 // 8 - 1]  # a slow gain hardly changes from one row to the next
        unchanged = np.abs(K - earlier) <= _UNCHANGED * (np.sqrt(np.diag(P) / R) + np.abs(K))
        unchanged_rows = unchanged_rows + 1 if len(gains) > _FIRST_CHECK and unchanged.all() else 0
    return Gains(np.array(gains).reshape(len(gains), model.states), unchanged_rows > model.states)


class CovarianceMap(NamedTuple):
    """The map of the prior covariance over L steps: P becomes Q + A (P^-1 + G)^-1 A'."""

    A: Floats  # (n, n)
    G: Floats  # (n, n)
    Q: Floats  # (n, n)

    def over(self, P: Floats) -> Floats:
        """Return the prior covariance (n, n) L steps later."""
        after = self.Q + self.A @ np.linalg.solve(np.eye(len(P)) + P @ self.G, P) @ self.A.T
        return (after + after.T) / 2

    def twice(self) -> CovarianceMap:
        """Return the map over twice as many steps (Anderson, Int. J. Control 28 (1978) 295)."""
        A, G, Q = self
        W = np.linalg.inv(np.eye(len(A)) + Q @ G)
        return CovarianceMap(A @ W @ A, G + A.T @ G @ W @ A, Q + A @ W @ Q @ A.T)


def covariance_map(model: Model) -> CovarianceMap:
    """Return the covariance map over one step of a model of one channel."""
    return CovarianceMap(model.F, model.H.T @ model.H / model.R[0, 0], model.process_covariance)
