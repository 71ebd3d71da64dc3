"""The gain that a filter settles at, found without filtering."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, frozen
from becalm.core.model.model import Model
from becalm.core.steady.steady_filter import SteadyFilter
from becalm.errors import ModelError

_DOUBLINGS = 80
_FADES = 1 - 1e-9  # largest eigenvalue of states that go to 0 by themselves


def steady(model: Model, output: ArrayLike | None = None) -> SteadyFilter:
    """Settle the gain of a one-channel model, by the doubling form of the Riccati equation.

    Parameters
    ----------
    model : Model
        One channel, n states.
    output : (n,) array_like, optional
        The row that makes the output from the states; H if not given.

    Raises
    ------
    ModelError
        If the model has several channels, R = 0, or no steady gain; or if the output sees what no reading does.

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
    model, row = _observed_part(model, _output_row(model, output))
    P = _solve_riccati(model, R)
    S = float((model.H @ P @ model.H.T)[0, 0]) + R
    K = P @ model.H.T / S
    return SteadyFilter(model, P, K, (np.eye(model.states) - K @ model.H) @ model.F, S, row)


FORGOTTEN = 1e-13
"""Share by which what later rows say may still depend on rows that are not there yet."""


def rows_until(share: float, model: Model) -> float:
    """Return after how many readings only a share is left of what a filter of one channel began with.

    Parameters
    ----------
    share : float
        Below 1; a *small* one is left later.
    model : Model
        One step a reading.

    Returns
    -------
    float
        inf of one that never forgets.
    """
    try:
        radius = float(np.abs(np.linalg.eigvals(steady(model).closed_loop)).max())
    except ModelError:  # it never forgets
        return np.inf
    return float(np.log(share) / np.log(max(radius, 1e-300))) if radius < 1.0 else np.inf


def _solve_riccati(model: Model, R: float) -> Floats:
    eye = np.eye(model.states)
    A, G, P = model.F.T.copy(), model.H.T @ model.H / R, model.process_covariance.copy()
    for _ in range(_DOUBLINGS):
        with np.errstate(over="ignore", invalid="ignore"):  # refused just below
            try:
                W = np.linalg.inv(eye + G @ P)
            except np.linalg.LinAlgError as cause:
                raise ModelError(
                    "This model is too slow for float64 to settle its gain; give it a larger Q."
                ) from cause
            A, G, ahead = A @ W @ A, G + A @ W @ G @ A.T, P + A.T @ P @ W @ A
        if not np.isfinite(ahead).all():
            raise ModelError("This model has no steady gain: its state grows faster than the readings tell.")
        settled = np.abs(ahead - P).max() <= 1e-15 * np.abs(ahead).max()
        P = (ahead + ahead.T) / 2
        if settled:
            return P
    raise ModelError("This model has no steady gain; some state is hardly observed and grows. Leave it out.")


def _output_row(model: Model, output: ArrayLike | None) -> Floats:
    if output is None:
        return model.H
    row = frozen(np.atleast_2d(np.asarray(output, dtype=np.float64)))
    if row.shape != (1, model.states):
        raise ModelError(f"output has shape {np.shape(output)}; give {model.states} numbers, one a state.")
    if not np.isfinite(row).all() or not row.any():
        raise ModelError(f"output = {row[0].tolist()} makes no output; give finite numbers, not all of them 0.")
    return row


def _observed_part(model: Model, row: Floats) -> tuple[Model, Floats]:
    """Leave out the directions that no reading sees, unless they fade by themselves."""
    hidden = model.unobservable
    if not hidden.shape[1] or np.abs(np.linalg.eigvals(hidden.T @ model.F @ hidden)).max() < _FADES:
        return model, row
    if np.abs(row @ hidden).max() > 1e-9 * np.abs(row).max():
        raise ModelError("The output sees a state that no reading determines; choose an output of observed states.")
    if hidden.shape[1] == model.states:
        raise ModelError("H sees no state, so that nothing can be filtered; give H a number that is not 0.")
    seen = np.linalg.svd(hidden)[0][:, hidden.shape[1] :]
    Q = seen.T @ model.process_covariance @ seen
    return Model(F=seen.T @ model.F @ seen, H=model.H @ seen, Q=(Q + Q.T) / 2, R=model.R), row @ seen
