"""The forward pass over a record: signal, standard uncertainty, innovations, exact likelihood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core import starting
from becalm.core.arrays import Floats, Integers, frozen, read_only, real
from becalm.core.components import Component, discretise
from becalm.core.kernel_steps import State, System, new_state
from becalm.core.kernels import Trace, forward
from becalm.core.model import Model
from becalm.core.verdict import BEYOND_ANY_SENSOR
from becalm.errors import ModelError


@dataclass(frozen=True)
class Estimate:
    """What a filter or smoother found; N readings, m channels, n states.

    Attributes
    ----------
    signal : (N, m) float array
        H x, the clean signal, in the channels' units.
    sigma : (N, m) float array
        One standard uncertainty of `signal`, same units; inf where nothing is known yet.
    log_likelihood : float
        Exact Gaussian log-likelihood. Without x0 and P0, of the readings after the first ones that
        were needed to know the state, given those.
    innovations, innovation_sigma : (N, m) float array
        Reading minus its prediction, and the standard deviation expected of it; NaN where a
        channel is missing or nothing could be predicted yet.
    mean : (N, n) float array or None
        States, on request.
    cov : (N, n, n) float array or None
        Covariance of the states, on request. Of a state that the readings do not determine
        (`Model.observable_states`) it is only what was gathered since the start.
    used : int
        Readings, channels counted one by one, that entered the likelihood.
    """

    signal: Floats
    sigma: Floats
    log_likelihood: float
    innovations: Floats
    innovation_sigma: Floats
    mean: Floats | None
    cov: Floats | None
    used: int


class Timeline(NamedTuple):
    """The step matrices of a record, and which of them precedes each row (-1: none)."""

    system: System
    which: Integers  # (N,)


def even_timeline(model: Model, count: int) -> Timeline:
    """Give every row of `count` the model's own step."""
    which = np.zeros(count, dtype=np.int64)
    which[:1] = -1
    return Timeline(model_system(model), which)


def model_system(model: Model) -> System:
    """Lay a model out for the kernels."""
    return System(model.F[np.newaxis], model.process_covariance[np.newaxis], model.H, model.R)


def elapsed_timeline(component: Component, noise_variance: float, elapsed: Floats) -> Timeline:
    """Give every row the exact step over the time since the row before.

    Parameters
    ----------
    component : Component
        The signal's model, in the time unit of `elapsed`.
    noise_variance : float
        R, in unit^2.
    elapsed : (N,) float array
        Time since the row before, 0 or more; the first is not used.
    """
    lengths, which = np.unique(elapsed[1:], return_inverse=True)
    F, Q = discretise(component, lengths if len(lengths) else np.ones(1))
    system = System(frozen(F), frozen(Q), component.output, frozen([[noise_variance]]))
    return Timeline(system, np.concatenate([[-1], which]).astype(np.int64)[: len(elapsed)])


def checked_readings(model: Model, z: ArrayLike) -> Floats:
    """Return z as (N, m) float64; Inf and magnitudes beyond any sensor become NaN, missing.

    Raises
    ------
    ModelError
        If z is not numbers or does not have the model's channels.
    """
    if not isinstance(model, Model):
        raise ModelError(f"A Model is needed; {type(model).__name__} came. Make one: becalm.Model(F=, H=, Q=, R=).")
    try:
        readings = np.asarray(real(z), dtype=np.float64)
    except (TypeError, ValueError) as cause:
        raise ModelError(f"z is not an array of numbers ({cause}).") from cause
    if readings.ndim == 1 and model.channels == 1:
        readings = readings[:, np.newaxis]
    if readings.ndim != 2 or readings.shape[1] != model.channels:
        wanted = "(N,) or (N, 1)" if model.channels == 1 else f"(N, {model.channels})"
        raise ModelError(f"z has shape {np.shape(z)}; this model needs {wanted}.")
    with np.errstate(invalid="ignore"):
        impossible = np.abs(readings) > BEYOND_ANY_SENSOR
    return np.where(impossible, np.nan, readings) if impossible.any() else np.ascontiguousarray(readings)


def kalman_filter(model: Model, z: ArrayLike, *, states: bool = False, covariances: bool = False) -> Estimate:
    """Filter readings causally: each estimate knows the readings up to its own.

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

    Raises
    ------
    ModelError
        If z does not fit the model, or the model cannot start without x0 and P0.

    Notes
    -----
    Kalman (1960) with Joseph's update; equations (1) to (8) of `becalm.core.reference`. Not to be
    confused with `kalman_smoother`, whose estimates also know the readings after their own.
    """
    readings = checked_readings(model, z)
    run = run_filter(model, even_timeline(model, len(readings)), readings, states=states, covariances=covariances)
    return run.estimate


class Run(NamedTuple):
    """A forward pass, with what a backward pass needs of it."""

    estimate: Estimate
    opening: starting.Opening | None  # of a start as information: no prior, or a wide one
    trace: Trace
    state: State


def run_filter(model: Model, timeline: Timeline, z: Floats, *, states: bool = False, covariances: bool = False) -> Run:
    """Filter z (N, m) over a timeline; see `kalman_filter`."""
    system, which = timeline
    trace = new_trace(model, len(z), states, covariances)
    opening, prior = None, starting.wide_prior(model)
    before = Sums(0.0, 0.0, 0)
    if model.x0 is not None and model.P0 is not None and prior is None:
        state, begun = new_state(model.x0, model.P0, model.channels), 0
    else:
        opening = starting.open_record(system, which, z, model.unobservable, prior)
        state, begun = new_state(opening.x, opening.P, model.channels), opening.rows
        write_opening(model, opening, trace)
        if prior is not None:
            before = score_opening(timeline, z, prior, opening, trace)
    rest = Trace(*(array[begun:] for array in trace))
    after = Sums(*forward(system, read_only(which[begun:]), read_only(z[begun:]), state, rest))
    squares, log_det, used = (a + b for a, b in zip(before, after, strict=True))
    estimate = Estimate(
        signal=trace.signal,
        sigma=np.sqrt(trace.variance),
        log_likelihood=float(-0.5 * (squares + log_det + used * np.log(2 * np.pi))),
        innovations=trace.innovation,
        innovation_sigma=np.sqrt(trace.innovation_variance),
        mean=trace.mean if states else None,
        cov=trace.cov if covariances else None,
        used=int(used),
    )
    return Run(estimate, opening, trace, state)


class Sums(NamedTuple):
    """What makes a log-likelihood."""

    squares: float  # of nu' S^-1 nu
    log_det: float  # of log det S
    used: int


def score_opening(
    timeline: Timeline, z: Floats, prior: starting.Information, opening: starting.Opening, trace: Trace
) -> Sums:
    """Predict each reading of an opening that had a prior, (3), (4) and (8), and write the innovations."""
    F, Q, H, R = timeline.system
    squares, log_det, used = 0.0, 0.0, 0
    x, P = starting.known_state(prior)
    for k, known in enumerate(opening.information):
        if k:
            step = timeline.which[k]
            x, P = F[step] @ x, F[step] @ P @ F[step].T + Q[step]
        arrived = np.isfinite(z[k])
        nu = (z[k] - H @ x)[arrived]
        S = (H @ P @ H.T + R)[np.ix_(arrived, arrived)]
        trace.innovation[k, arrived], trace.innovation_variance[k, arrived] = nu, np.diag(S)
        if arrived.any():
            squares += float(nu @ np.linalg.solve(S, nu))
            log_det += float(np.linalg.slogdet(S)[1])
            used += len(nu)
        x, P = starting.known_state(known)
        if len(trace.mean):
            trace.mean[k] = x
        if len(trace.cov):
            trace.cov[k] = P
    return Sums(squares, log_det, used)


def new_trace(model: Model, count: int, states: bool, covariances: bool) -> Trace:
    """Make room for the results of `count` rows; innovations start as NaN."""
    n, m = model.states, model.channels
    return Trace(
        signal=np.empty((count, m)),
        variance=np.empty((count, m)),
        innovation=np.full((count, m), np.nan),
        innovation_variance=np.full((count, m), np.nan),
        mean=np.empty((count if states else 0, n)),
        cov=np.empty((count if covariances else 0, n, n)),
    )


def write_opening(model: Model, opening: starting.Opening, trace: Trace) -> None:
    """Write the rows of a start as information; NaN and inf where nothing is known yet."""
    rows = opening.rows
    trace.signal[:rows], trace.variance[:rows] = np.nan, np.inf
    trace.mean[:rows], trace.cov[:rows] = np.nan, np.inf
    for k, now in enumerate(opening.information, start=opening.first):
        trace.signal[k], trace.variance[k] = starting.estimable(now, model.H)
    if opening.known:
        last = rows - 1
        trace.mean[last:rows], trace.cov[last:rows] = opening.x, opening.P
