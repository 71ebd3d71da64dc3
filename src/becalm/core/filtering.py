"""The forward pass over a record: signal, standard uncertainty, innovations, exact likelihood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core import starting
from becalm.core.arrays import BLOCK, Floats, real
from becalm.core.kernel_settling import COVARIANCE, GAIN, new_memory
from becalm.core.kernels import Trace, forward
from becalm.core.model import Model
from becalm.core.sized import Sizes, size
from becalm.core.sums import Sums
from becalm.core.timeline import Timeline, even_timeline
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
    settled_row : int or None
        The first row whose gain was the settled one; None if it never settled.

    Notes
    -----
    `sigma`, or `innovations` and `innovation_sigma`, have no rows where they were not asked for.
    """

    signal: Floats
    sigma: Floats
    log_likelihood: float
    innovations: Floats
    innovation_sigma: Floats
    mean: Floats | None
    cov: Floats | None
    used: int
    settled_row: int | None


class Wanted(NamedTuple):
    """Which results are to be written; the likelihood always is."""

    states: bool = False
    covariances: bool = False
    sigma: bool = True
    innovations: bool = True
    signal: bool = True
    predictions: bool = False  # of the readings, which a backward pass needs


EVERYTHING = Wanted()


def checked_readings(model: Model, z: ArrayLike) -> Floats:
    """Return z as (N, m) float64 in rows.

    Raises
    ------
    ModelError
        If z is not numbers or does not have the model's channels.
    """
    if not isinstance(model, Model):
        raise ModelError(f"A Model is needed; {type(model).__name__} came. Make one: becalm.Model(F=, H=, Q=, R=).")
    readings = z if isinstance(z, np.ndarray) and z.dtype == np.float64 else numbers(z)
    if readings.ndim == 1 and model.channels == 1:
        readings = readings[:, np.newaxis]
    if readings.ndim != 2 or readings.shape[1] != model.channels:
        wanted = "(N,) or (N, 1)" if model.channels == 1 else f"(N, {model.channels})"
        many = " For many records at once use becalm.core.batch.filter_batch." if readings.ndim == 3 else ""
        raise ModelError(f"z has shape {np.shape(z)}; this model needs {wanted}.{many}")
    return np.ascontiguousarray(readings)


def numbers(z: ArrayLike) -> Floats:
    """Return float64 numbers, or say that these are none."""
    try:
        return np.asarray(real(z), dtype=np.float64)
    except (TypeError, ValueError) as cause:
        raise ModelError(f"z is not an array of numbers ({cause}).") from cause


def kalman_filter(  # noqa: PLR0913  (what is wanted, each by its name)
    model: Model,
    z: ArrayLike,
    *,
    states: bool = False,
    covariances: bool = False,
    sigma: bool = True,
    innovations: bool = True,
) -> Estimate:
    """Filter readings causally: each estimate knows the readings up to its own.

    Parameters
    ----------
    model : Model
        The signal and its sensors, one step a row.
    z : (N,) or (N, m) array_like
        Readings in the channels' units; NaN or Inf where one did not arrive, and what no sensor
        reads (beyond 1e100) counts as such. Never modified.
    states, covariances : bool
        Whether to return `mean` (N, n) and `cov` (N, n, n).
    sigma, innovations : bool
        Whether to return `sigma`, and `innovations` with `innovation_sigma`; without them less is written.

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
    wanted = Wanted(states, covariances, sigma, innovations)
    return run_filter(model, even_timeline(model, len(readings)), readings, wanted).estimate


class Run(NamedTuple):
    """A forward pass, with what a backward pass, or the rows that follow, need of it."""

    estimate: Estimate
    opening: starting.Opening | None  # of a start as information: no prior, or a wide one
    begun: int  # the first row after the opening
    memory: Floats  # (1, M), or with room for one more each block, as `forward` leaves it
    prediction: Floats  # (m, N) where wanted


class Pass(NamedTuple):
    """How a forward pass is made."""

    wanted: Wanted = EVERYTHING
    enough: float = GAIN  # what has to settle before a gain is used again
    remember: bool = False  # what a backward pass needs


def run_filter(model: Model, timeline: Timeline, z: Floats, wanted: Wanted = EVERYTHING) -> Run:
    """Filter z (N, m) over a timeline; see `kalman_filter`."""
    return start_filter(model, timeline, z, Pass(wanted, COVARIANCE if wanted.covariances else GAIN))


def start_filter(model: Model, timeline: Timeline, z: Floats, how: Pass) -> Run:
    """Filter a record from its first row on."""
    prior = starting.wide_prior(model)
    if model.x0 is not None and model.P0 is not None and prior is None:
        memory = new_memory(model.x0, model.P0, model.channels, _rows_to_remember(z, how))
        return _run(Task(model, timeline, z, 0), memory, how, new_trace(model, len(z), how.wanted), Sums())
    opening = starting.open_record(timeline, z, model, prior)
    trace = new_trace(model, len(z), how.wanted)
    write_opening(model, opening, trace)
    before = Sums() if prior is None else score_opening(timeline, z, prior, opening, trace)
    memory = new_memory(opening.x, opening.P, model.channels, _rows_to_remember(z, how))
    return _run(Task(model, timeline, z, opening.rows), memory, how, trace, before)._replace(opening=opening)


def _rows_to_remember(z: Floats, how: Pass) -> int:
    return 2 + len(z) // BLOCK if how.remember else 1


class Task(NamedTuple):
    """What is to be filtered."""

    model: Model
    timeline: Timeline
    z: Floats  # (N, m)
    begun: int  # rows before are done


def _run(task: Task, memory: Floats, how: Pass, trace: Trace, before: Sums) -> Run:
    model, timeline, z, begun = task
    found = forward(sizes_of(model), timeline.system, timeline.record(z), begun, how.enough, memory, trace)
    total, settled = before.plus(Sums(*found[:3])), found[3]
    estimate = Estimate(
        signal=trace.signal.T,
        sigma=trace.sigma.T,
        log_likelihood=total.log_likelihood,
        innovations=trace.innovation.T,
        innovation_sigma=trace.innovation_sigma.T,
        mean=trace.mean.T if how.wanted.states else None,
        cov=np.moveaxis(trace.cov, 2, 0) if how.wanted.covariances else None,
        used=int(total.used),
        settled_row=None if settled < 0 else int(settled),
    )
    return Run(estimate, None, begun, memory, trace.prediction)


def sizes_of(model: Model) -> Sizes:
    """Return the sizes that kernels are specialised for."""
    return Sizes(size(model.states), size(model.channels))


def score_opening(
    timeline: Timeline, z: Floats, prior: starting.Information, opening: starting.Opening, trace: Trace
) -> Sums:
    """Predict each reading of an opening that had a prior, (3), (4) and (8), and write the innovations."""
    F, Q, H, R = timeline.system
    (x, P), total = starting.known_state(prior), Sums()
    for k, known in enumerate(opening.information):
        if k:
            step = timeline.step_before(k)
            x, P = F[step] @ x, F[step] @ P @ F[step].T + Q[step]
        arrived = starting.arrived(z[k])
        nu = (z[k] - H @ x)[arrived]
        S = (H @ P @ H.T + R)[np.ix_(arrived, arrived)]
        if trace.innovation.size:
            trace.innovation[arrived, k], trace.innovation_sigma[arrived, k] = nu, np.sqrt(np.diag(S))
        if arrived.any():
            total = total.plus(Sums(float(nu @ np.linalg.solve(S, nu)), float(np.linalg.slogdet(S)[1]), len(nu)))
        x, P = starting.known_state(known)
        if trace.mean.size:
            trace.mean[:, k] = x
        if trace.cov.size:
            trace.cov[:, :, k] = P
    return total


def new_trace(model: Model, count: int, wanted: Wanted) -> Trace:
    """Make room for the results of `count` rows."""
    n, m = model.states, model.channels
    return Trace(
        signal=np.empty((m, count if wanted.signal else 0)),
        sigma=np.empty((m, count if wanted.sigma else 0)),
        innovation=np.empty((m, count if wanted.innovations else 0)),
        innovation_sigma=np.empty((m, count if wanted.innovations else 0)),
        prediction=np.empty((m, count if wanted.predictions else 0)),
        mean=np.empty((n, count if wanted.states else 0)),
        cov=np.empty((n, n, count if wanted.covariances else 0)),
    )


def write_opening(model: Model, opening: starting.Opening, trace: Trace) -> None:
    """Write the rows of a start as information; NaN and inf where nothing is known yet."""
    rows = opening.rows
    trace.signal[:, :rows], trace.sigma[:, :rows] = np.nan, np.inf
    trace.mean[:, :rows], trace.cov[:, :, :rows] = np.nan, np.inf
    for missing in (trace.innovation, trace.innovation_sigma, trace.prediction):
        missing[:, :rows] = np.nan
    for k, now in enumerate(opening.information, start=opening.first):
        signal, variance = starting.estimable(now, model.H)
        if trace.signal.size:
            trace.signal[:, k] = signal
        if trace.sigma.size:
            trace.sigma[:, k] = np.sqrt(variance)
    if opening.known:
        last = rows - 1
        trace.mean[:, last:rows] = opening.x[:, np.newaxis]
        trace.cov[:, :, last:rows] = opening.P[:, :, np.newaxis]
