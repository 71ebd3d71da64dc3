"""The steady-state gain of a filter, from the Riccati equation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, frozen
from becalm.core.model.model import Model
from becalm.core.steady.steady_filter import SteadyFilter
from becalm.errors import ModelError

_DOUBLINGS = 80
_DECAYS = 1 - 1e-9  # largest eigenvalue of states that decay to 0


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
        If the model has several channels, R = 0 or no steady-state gain, or if the output depends on an
        unobservable state.

    Notes
    -----
    Anderson, Int. J. Control 28 (1978) 295: each pass doubles the number of steps. The method stays accurate for the
    small process noise of high rates, where eigenvalue methods fail.
    """
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
"""Largest relative influence of rows that have not arrived yet on later estimates."""


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
    row = frozen(np.atleast_2d(np.asarray(output, dtype=np.float64)))
    if row.shape != (1, model.states):
        raise ModelError(f"output has shape {np.shape(output)}; give {model.states} numbers, one per state.")
    if not np.isfinite(row).all() or not row.any():
        raise ModelError(f"output = {row[0].tolist()} makes no output; give finite numbers, not all of them 0.")
    return row


def _observed_part(model: Model, row: Floats) -> tuple[Model, Floats]:
    """Return model and output row without unobservable directions, unless these decay to 0."""
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
