"""The forward pass over a record: signal, standard uncertainty, innovations, exact likelihood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, real
from becalm.core.filter.likelihood_sums import Sums
from becalm.core.model.model import Model
from becalm.core.model.prior import known_before, refuse_singular, root_of, wide_prior
from becalm.core.model.timeline import Timeline, even_timeline
from becalm.errors import ModelError
from becalm.native.multivariate import (
    COVARIANCE,
    GAIN,
    MOST_CHANNELS,
    MOST_STATES,
    EstimateBuffers,
    MeasurementRows,
    Multivariate,
)


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


class WantedResults(NamedTuple):
    """Which results are to be written; the likelihood always is."""

    states: bool = False
    covariances: bool = False
    sigma: bool = True
    innovations: bool = True
    signal: bool = True


EVERYTHING = WantedResults()


def require_model(model: object) -> None:
    """Refuse what is no Model."""
    if not isinstance(model, Model):
        raise ModelError(f"A Model is needed; {type(model).__name__} came. Make one: becalm.Model(F=, H=, Q=, R=).")


def checked_readings(model: Model, z: ArrayLike) -> Floats:
    """Return z as (N, m) float64 in rows.

    Raises
    ------
    ModelError
        If z is not numbers or does not have the model's channels.
    """
    require_model(model)
    readings = z if type(z) is np.ndarray and z.dtype == np.float64 else numbers(z)
    if readings.ndim == 1 and model.channels == 1:
        readings = readings[:, np.newaxis]
    if readings.ndim != 2 or readings.shape[1] != model.channels:
        wanted = "(N,) or (N, 1)" if model.channels == 1 else f"(N, {model.channels})"
        many = " For many records at once use becalm.core.filter.batch.filter_batch." if readings.ndim == 3 else ""
        raise ModelError(f"z has shape {np.shape(z)}; this model needs {wanted}.{many}")
    return np.ascontiguousarray(readings)


def numbers(z: ArrayLike) -> Floats:
    """Return float64 numbers, or say that these are none."""
    try:
        return np.asarray(real(z), dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as cause:
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
    Kalman (1960) with Joseph's update; equations (1) to (8) of `becalm.core.reference.kalman`. Not to be
    confused with `kalman_smoother`, whose estimates also know the readings after their own.
    """
    readings = checked_readings(model, z)
    wanted = WantedResults(states, covariances, sigma, innovations)
    return run_filter(model, even_timeline(model, len(readings)), readings, wanted).estimate


class Run(NamedTuple):
    """A forward pass."""

    estimate: Estimate
    begun: int  # the first row after those that were needed to know the state
    cov: Floats  # (n, n) of the state after the last row, if it is known


def run_filter(model: Model, timeline: Timeline, z: Floats, wanted: WantedResults = EVERYTHING) -> Run:
    """Filter z (N, m) over a timeline; see `kalman_filter`."""
    kernel, beliefs = new_kernel(model, timeline, wanted), new_beliefs(model, len(z), wanted)
    kernel.filter(rows_of(timeline, z), beliefs)
    return Run(estimate_of(kernel, beliefs), int(kernel.head["opened"]), kernel.covariance.copy())


def new_kernel(model: Model, timeline: Timeline, wanted: WantedResults) -> Multivariate:
    """Return a filter before the first row: at x0 and P0, or with what is known without them.

    Raises
    ------
    ModelError
        If the model is too large, or cannot start without x0 and P0.
    """
    n, m = model.states, model.channels
    if n > MOST_STATES or m > MOST_CHANNELS:
        raise ModelError(
            f"The model has {n} states and {m} channels; up to {MOST_STATES} states and {MOST_CHANNELS} channels are"
            " filtered together. Leave some out, or filter independent channels by models of their own."
        )
    H, R = (np.require(array, np.float64, ["C", "A"]) for array in (timeline.system.H, timeline.system.R))
    x0, P0 = model.x0, model.P0
    enough, prior = COVARIANCE if wanted.covariances else GAIN, wide_prior(model)
    if x0 is not None and P0 is not None and prior is None:
        kernel = Multivariate(H, R, np.zeros((n, n)), np.zeros(n), enough=enough)
        kernel.start(x0, P0)
        return kernel
    refuse_singular(timeline.system)
    root = root_of((prior or known_before(model)).Y)
    if x0 is None:
        return Multivariate(H, R, root, np.zeros(n), enough=enough)
    return Multivariate(H, R, root, root @ x0, foretells=True, enough=enough)


def rows_of(timeline: Timeline, z: Floats) -> MeasurementRows:
    """Lay z (N, m) out for the filter in C, beside the steps."""
    F, Q = timeline.system.F, timeline.system.Q
    lengths = timeline.lengths if len(timeline.lengths) == len(F) else np.arange(float(len(F)))
    z, F, Q, lengths = (np.require(array, np.float64, ["C", "A"]) for array in (z, F, Q, lengths))
    return MeasurementRows(z, timeline.first, timeline.step, F, Q, lengths)


def new_beliefs(model: Model, count: int, wanted: WantedResults) -> EstimateBuffers:
    """Make room for what is wanted of `count` rows."""
    n, m = model.states, model.channels
    asked = (wanted.signal, wanted.sigma, wanted.innovations, wanted.innovations, wanted.states, wanted.covariances)
    shapes = ((count, m),) * 4 + ((count, n), (count, n, n))
    return EstimateBuffers(*(np.empty(shape) if asks else None for asks, shape in zip(asked, shapes, strict=True)))


def sums_of(kernel: Multivariate) -> Sums:
    """Return what makes the log-likelihood of the rows that were filtered."""
    head = kernel.head
    log_det = np.log(head["product"]) + head["exponent"] * np.log(2.0)
    return Sums(float(head["squares"]), float(log_det), int(head["used"]))


def estimate_of(kernel: Multivariate, beliefs: EstimateBuffers) -> Estimate:
    """Return what was found; what was not wanted has no rows, or is None."""
    head = kernel.head
    signal, sigma, innovation, deviation, mean, cov = beliefs
    nothing = np.empty((0, kernel.channels))
    return Estimate(
        signal=nothing if signal is None else signal,
        sigma=nothing if sigma is None else sigma,
        log_likelihood=sums_of(kernel).log_likelihood,
        innovations=nothing if innovation is None else innovation,
        innovation_sigma=nothing if deviation is None else deviation,
        mean=mean,
        cov=cov,
        used=int(head["used"]),
        settled_row=None if head["settled_row"] < 0 else int(head["settled_row"]),
    )
