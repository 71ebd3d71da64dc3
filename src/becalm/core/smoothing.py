"""The backward pass over a record: every estimate knows all readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from becalm.core import starting
from becalm.core.arrays import Floats
from becalm.core.filtering import Estimate, Run, Timeline, checked_readings, even_timeline, run_filter
from becalm.core.kernel_steps import new_state
from becalm.core.kernels import Future, Trace, backward
from becalm.core.model import Model


def kalman_smoother(model: Model, z: ArrayLike, *, states: bool = False, covariances: bool = False) -> Estimate:
    """Smooth readings: each estimate knows the whole record, before and after its own time.

    Parameters
    ----------
    model : Model
        The signal and its sensors, one step a row.
    z : (N,) or (N, m) array_like
        Readings in the channels' units; NaN or Inf where one did not arrive. Never modified.
    states, covariances : bool
        Whether to return `mean` (N, n) and `cov` (N, n, n).

    Returns
    -------
    Estimate
        Innovations and likelihood are those of the forward pass.

    Raises
    ------
    ModelError
        If z does not fit the model, or the model cannot start without x0 and P0.

    Notes
    -----
    Bryson and Frazier (1963) in Bierman's form (1973), which gives the same as Rauch, Tung and
    Striebel (1965) without inverting a covariance; equations (9) to (12) of
    `becalm.core.reference`. With a flat start the mean is that of penalised least squares.
    """
    readings = checked_readings(model, z)
    return run_smoother(model, even_timeline(model, len(readings)), readings, states=states, covariances=covariances)


def run_smoother(
    model: Model, timeline: Timeline, z: Floats, *, states: bool = False, covariances: bool = False
) -> Estimate:
    """Smooth z (N, m) over a timeline; see `kalman_smoother`."""
    run = run_filter(model, timeline, z, states=True, covariances=True)
    if len(z) and (run.opening is None or run.opening.known):
        _go_back(model, timeline, run)
    forward = run.estimate
    return Estimate(
        signal=run.trace.signal,
        sigma=np.sqrt(run.trace.variance),
        log_likelihood=forward.log_likelihood,
        innovations=forward.innovations,
        innovation_sigma=forward.innovation_sigma,
        mean=run.trace.mean if states else None,
        cov=run.trace.cov if covariances else None,
        used=forward.used,
    )


def _go_back(model: Model, timeline: Timeline, run: Run) -> None:
    """Overwrite the filtered results of a run by smoothed ones."""
    n = model.states
    begun = 0 if run.opening is None else run.opening.rows - 1
    rest = Trace(*(array[begun:] for array in run.trace))
    future = Future(np.zeros(n), np.zeros((n, n)), np.zeros((2, n, n)))
    state = new_state(np.zeros(n), np.zeros((n, n)), model.channels)
    backward(timeline.system, timeline.which[begun:], rest, state, future)
    if run.opening is not None:
        _smooth_opening(model, timeline, run.opening, run.trace)


def _smooth_opening(model: Model, timeline: Timeline, opening: starting.Opening, trace: Trace) -> None:
    """Regress each row of the opening on the row after it, backwards."""
    system, which = timeline
    nothing = starting.Information(np.zeros_like(opening.P), np.zeros_like(opening.x))
    H = model.H
    for k in range(opening.rows - 2, -1, -1):
        now = opening.information[k - opening.first] if k >= opening.first else nothing
        step = which[k + 1]
        J, c, W = starting.regress(now, system.F[step], system.Q[step])
        trace.mean[k] = J @ trace.mean[k + 1] + c
        cov = J @ trace.cov[k + 1] @ J.T + W
        trace.cov[k] = (cov + cov.T) / 2
        trace.signal[k] = H @ trace.mean[k]
        trace.variance[k] = np.einsum("ai,ij,aj->a", H, trace.cov[k], H)
