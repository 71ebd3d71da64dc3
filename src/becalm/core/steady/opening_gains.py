"""The gains of a causal filter of one channel before it has run: from nothing known to where they have settled.

Gains depend on no reading, so that a filter whose readings all arrive can be written down as numbers: the weights of
the first readings, by which a state is known at all, a gain for each row after them, and the one that stays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.covariances import covariance_after, covariance_ahead
from becalm.core.model.model import Model
from becalm.core.model.prior import known_before, refuse_singular, root_of
from becalm.core.model.timeline import model_system
from becalm.errors import ModelError

_LONGEST_OPENING = 4096
_WELL_DETERMINED, _LIVE = 1e-6, 3e-5  # those of native/opening.h
_UNCHANGED, _FIRST_CHECK = 1e-13, 32  # beside a state's spread, over the last eighth; in rows


class Opening(NamedTuple):
    """What is known once the first readings, none of them missing, have told the state."""

    weights: Floats  # (o, n): the state after o readings z is weights.T @ z
    P: Floats  # (n, n) its covariance, in unit^2


def open_at(model: Model) -> Opening:
    """Find how the first readings of a model of one channel tell its state.

    Parameters
    ----------
    model : Model
        One channel, one step a reading, without x0 and P0.

    Raises
    ------
    ModelError
        If F or R has no inverse, or thousands of readings do not tell the state.

    Notes
    -----
    Square root information filter (Bierman 1977, chapter V): U x = b + e with e ~ N(0, I). Its right-hand side is kept
    as what each reading has become of it, since it is linear in them.
    """
    refuse_singular(model_system(model))
    n = model.states
    prior = np.pad(root_of(known_before(model).Y), ((0, 0), (0, 1)))
    noise, seen = root_of(model.process_covariance).T, np.append(model.H[0], 1.0) / np.sqrt(model.R[0, 0])
    known = _triangular(np.vstack([prior, seen]), n)
    while not _is_told(known[:, :n]):
        if known.shape[1] - n == _LONGEST_OPENING:
            raise ModelError(f"{_LONGEST_OPENING} readings do not tell the state of this model; leave a tone out.")
        told = np.hstack([seen[:n], np.zeros(known.shape[1] - n), seen[n:]])
        known = np.pad(_onward(known, model.F, noise, prior), ((0, 0), (0, 1)))
        known = _triangular(np.vstack([known, told]), n)
    back = np.linalg.inv(known[:, :n])
    return Opening((back @ known[:, n:]).T, back @ back.T)


def _is_told(U: Floats) -> bool:
    """Return what `try_to_determine` of `native/opening.h` says of a root of information."""
    length = np.linalg.norm(U, axis=0)
    if (np.abs(np.diag(U)) <= _LIVE * length).any():
        return False
    return bool(_WELL_DETERMINED * np.sum((np.linalg.inv(U) * length[:, np.newaxis]) ** 2) < 1)


def _triangular(equations: Floats, n: int) -> Floats:
    """Return equations (r, n + o) of n states as n, U beside what they equal."""
    return np.asarray(np.linalg.qr(equations, mode="r")[:n], dtype=np.float64)


def _onward(known: Floats, F: Floats, noise: Floats, prior: Floats) -> Floats:
    """Predict equations (n, n + o) one step; after one so long that F has lost its inverse only the prior is left."""
    n = len(F)
    try:
        W = known[:, :n] @ np.linalg.inv(F)
    except np.linalg.LinAlgError:  # what fades has become 0
        return np.pad(prior[:, :n], ((0, 0), (0, known.shape[1] - n)))
    first = np.hstack([np.eye(n), np.zeros_like(known)])
    second = np.hstack([-W @ noise, W, known[:, n:]])
    return _triangular(np.vstack([first, second]), 2 * n)[n:, n:]


class Gains(NamedTuple):
    """The gains of rows that follow an opening."""

    K: Floats  # (r, n) the last of them is the one that stays, where the gain has settled
    settled: bool


def gains_after(opening: Opening, model: Model, most: int) -> Gains:
    """Return the gains of the rows after an opening until they settle; equations as in `core/reference/kalman.py`.

    Parameters
    ----------
    opening : Opening
        Of the same model.
    model : Model
        One channel, one step a reading.
    most : int
        Rows after which it is given up.
    """
    h, R = model.H[0], float(model.R[0, 0])
    P, alike = opening.P, 0
    found: list[Floats] = []
    while len(found) < most and alike <= model.states:
        P = covariance_ahead(P, model)
        Ph = P @ h
        K = Ph / (h @ Ph + R)  # (4), (5)
        P = covariance_after(P, K[:, np.newaxis], model)
        found.append(K)
        then = found[len(found) * 7 // 8 - 1]  # a slow gain hardly changes from one row to the next
        unchanged = np.abs(K - then) <= _UNCHANGED * (np.sqrt(np.diag(P) / R) + np.abs(K))
        alike = alike + 1 if len(found) > _FIRST_CHECK and unchanged.all() else 0
    return Gains(np.array(found).reshape(len(found), model.states), alike > model.states)


class Leap(NamedTuple):
    """What L steps do to a covariance: P becomes Q + A (P^-1 + G)^-1 A', here for P before the update."""

    A: Floats
    G: Floats
    Q: Floats

    def over(self, P: Floats) -> Floats:
        """Return the covariance (n, n) L steps later."""
        after = self.Q + self.A @ np.linalg.solve(np.eye(len(P)) + P @ self.G, P) @ self.A.T
        return (after + after.T) / 2

    def twice(self) -> Leap:
        """Return the leap of twice as many steps (Anderson, Int. J. Control 28 (1978) 295)."""
        A, G, Q = self
        W = np.linalg.inv(np.eye(len(A)) + Q @ G)
        return Leap(A @ W @ A, G + A.T @ G @ W @ A, Q + A @ W @ Q @ A.T)


def leap_of(model: Model) -> Leap:
    """Return the leap of one step of a model of one channel."""
    return Leap(model.F, model.H.T @ model.H / model.R[0, 0], model.process_covariance)
