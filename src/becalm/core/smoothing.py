"""The backward pass over a record: every estimate knows all readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from becalm.core import starting
from becalm.core.arrays import BLOCK, Floats
from becalm.core.filtering import (
    EVERYTHING,
    Estimate,
    Pass,
    Run,
    Task,
    Wanted,
    checked_readings,
    new_trace,
    run_filter,
    sizes_of,
    start_filter,
)
from becalm.core.kernel_backward import backward
from becalm.core.kernel_return import Future, new_future
from becalm.core.kernel_settling import COVARIANCE, GAIN
from becalm.core.kernels import Trace
from becalm.core.model import Model
from becalm.core.timeline import Timeline, even_timeline


def kalman_smoother(  # noqa: PLR0913  (what is wanted, each by its name)
    model: Model,
    z: ArrayLike,
    *,
    states: bool = False,
    covariances: bool = False,
    sigma: bool = True,
    innovations: bool = True,
) -> Estimate:
    """Smooth readings: each estimate knows the whole record, before and after its own time.

    Parameters
    ----------
    model : Model
        The signal and its sensors, one step a row.
    z : (N,) or (N, m) array_like
        Readings in the channels' units; NaN or Inf where one did not arrive. Never modified.
    states, covariances : bool
        Whether to return `mean` (N, n) and `cov` (N, n, n).
    sigma, innovations : bool
        Whether to return `sigma`, and `innovations` with `innovation_sigma`; without them less is done.
        Covariances bring `sigma` with them.

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
    wanted = Wanted(states, covariances, sigma or covariances, innovations)
    return run_smoother(model, even_timeline(model, len(readings)), readings, wanted)


def run_smoother(model: Model, timeline: Timeline, z: Floats, wanted: Wanted = EVERYTHING) -> Estimate:
    """Smooth z (N, m) over a timeline; see `kalman_smoother`."""
    how = _forward_pass(wanted)
    run = start_filter(model, timeline, z, how)
    if run.opening is not None and not run.opening.known:
        return run_filter(model, timeline, z, wanted).estimate
    trace = _room_to_return(model, run, wanted)
    _go_back(Task(model, timeline, z, run.begun), run, how, new_future(model.states), trace)
    return replace(
        run.estimate,
        signal=trace.signal.T,
        sigma=trace.sigma.T,
        mean=trace.mean.T if wanted.states else None,
        cov=np.moveaxis(trace.cov, 2, 0) if wanted.covariances else None,
    )


def _forward_pass(wanted: Wanted) -> Pass:
    """Say how the forward pass is made whose backward pass shall give what is wanted."""
    forward = Wanted(signal=False, sigma=False, innovations=wanted.innovations, predictions=True)
    return Pass(forward, COVARIANCE if wanted.covariances else GAIN, remember=True)


def _room_to_return(model: Model, run: Run, wanted: Wanted) -> Trace:
    """Make room for what a backward pass writes, the signal in the place of the predictions."""
    room = new_trace(model, run.prediction.shape[1], wanted._replace(innovations=False, signal=False))
    return room._replace(prediction=run.prediction, signal=run.prediction if wanted.signal else room.signal)


def _go_back(task: Task, run: Run, how: Pass, future: Future, trace: Trace) -> None:
    """Smooth the rows that were filtered; `future`, what later rows say, is carried back before them."""
    model, timeline, z, begun = task
    rows = np.empty((BLOCK, run.memory.shape[1]))
    backward(sizes_of(model), timeline.system, timeline.record(z), begun, how.enough, run.memory, rows, future, trace)
    if run.opening is not None:
        _smooth_opening(model, timeline, run.opening, future, trace)


def _smooth_opening(model: Model, timeline: Timeline, opening: starting.Opening, future: Future, trace: Trace) -> None:
    """Smooth the last row of the opening, (9) and (10), and regress each row before on the row after it.

    Of a row before the first reading the model knows what it knows of any: a motion comes from where it returns to.
    """
    system, last = timeline.system, opening.rows - 1
    before = starting.known_before(model)
    x, P = opening.x + opening.P @ future.r, opening.P - opening.P @ future.N @ opening.P
    for k in range(last, -1, -1):
        if k < last:
            now = opening.information[k - opening.first] if k >= opening.first else before
            step = timeline.step_before(k + 1)
            J, c, W = starting.regress(now, system.F[step], system.Q[step])
            x, P = J @ x + c, J @ P @ J.T + W
        P = (P + P.T) / 2
        trace.signal[:, k] = system.H @ x
        if trace.sigma.size:
            trace.sigma[:, k] = np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", system.H, P, system.H), 0.0))
        if trace.mean.size:
            trace.mean[:, k] = x
        if trace.cov.size:
            trace.cov[:, :, k] = P
