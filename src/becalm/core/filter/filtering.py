"""Filter a record forward: estimate signal and uncertainty, and compute innovations and the exact likelihood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, real
from becalm.core.filter.channel import Sums
from becalm.core.model.model import Model
from becalm.core.model.prior import flat_prior, refuse_singular, root_of, wide_prior
from becalm.core.model.step_matrices import Timeline, even_timeline
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
    """The result of a filter or smoother for N readings, m channels and n states.

    Attributes
    ----------
    signal : (N, m) float array
        H x, the clean signal, in the channels' units.
    sigma : (N, m) float array
        One standard uncertainty of `signal`, same units; inf while the signal is undetermined.
    log_likelihood : float
        Exact Gaussian log-likelihood. Without x0 and P0 it is the likelihood of the later readings, given the first
        readings, which determine the state.
    innovations, innovation_sigma : (N, m) float array
        Reading minus its prediction, and the expected standard deviation of this difference; NaN where the
        reading is missing or there is no prediction yet.
    mean : (N, n) float array or None
        States, on request.
    cov : (N, n, n) float array or None
        Covariance of the states, on request. The variance of a state that the readings do not determine
        (`Model.observable_states`) follows from an assumed unit variance at the start.
    used : int
        Number of readings in the likelihood; each channel of a row counts as one.
    settled_row : int or None
        The first row with the steady-state gain; None if the gain did not reach a steady state.

    Notes
    -----
    `sigma`, `innovations` and `innovation_sigma` have no rows if the caller did not request them.
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
    """Flags for the results that the caller requests; the likelihood is always computed."""

    states: bool = False
    covariances: bool = False
    sigma: bool = True
    innovations: bool = True
    signal: bool = True


DEFAULT_RESULTS = WantedResults()


def require_model(model: object) -> None:
    """Raise a ModelError unless `model` is a Model."""
    if not isinstance(model, Model):
        raise ModelError(f"A Model is needed; {type(model).__name__} came. Make one: becalm.Model(F=, H=, Q=, R=).")


def checked_readings(model: Model, z: ArrayLike) -> Floats:
    """Return z as a C-contiguous (N, m) float64 array.

    Raises
    ------
    ModelError
        If z does not hold numbers or its shape does not fit the model's channels.
    """
    require_model(model)
    readings = z if type(z) is np.ndarray and z.dtype == np.float64 else numbers(z)
    if readings.ndim == 1 and model.channels == 1:
        readings = readings[:, np.newaxis]
    if readings.ndim != 2 or readings.shape[1] != model.channels:
        wanted = "(N,) or (N, 1)" if model.channels == 1 else f"(N, {model.channels})"
        hint = " For many records at once use becalm.core.filter.batch.filter_batch." if readings.ndim == 3 else ""
        raise ModelError(f"z has shape {np.shape(z)}; this model needs {wanted}.{hint}")
    return np.ascontiguousarray(readings)


def numbers(z: ArrayLike) -> Floats:
    """Return z as float64 numbers; raise a ModelError if it does not hold numbers."""
    try:
        return np.asarray(real(z), dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as cause:
        raise ModelError(f"z is not an array of numbers ({cause}).") from cause


def kalman_filter(  # noqa: PLR0913  (one flag for each result)
    model: Model,
    z: ArrayLike,
    *,
    states: bool = False,
    covariances: bool = False,
    sigma: bool = True,
    innovations: bool = True,
) -> Estimate:
    """Filter readings causally: each estimate uses the readings up to its own row.

    Parameters
    ----------
    model : Model
        Model of the signal and its sensors, one step per row.
    z : (N,) or (N, m) array_like
        Readings in the channels' units; NaN or Inf where a reading is missing. Magnitudes above 1e100, which no sensor
        gives, also count as missing. The array is not modified.
    states, covariances : bool
        Whether to return `mean` (N, n) and `cov` (N, n, n).
    sigma, innovations : bool
        Whether to return `sigma`, and `innovations` with `innovation_sigma`; without them the filter is faster.

    Returns
    -------
    Estimate

    Raises
    ------
    ModelError
        If z does not fit the model, or the model cannot start without x0 and P0.

    Notes
    -----
    Kalman (1960) with Joseph's update; equations (1) to (8) of `becalm.core.reference.kalman`. `kalman_smoother` also
    uses the later readings.
    """
    readings = checked_readings(model, z)
    wanted = WantedResults(states, covariances, sigma, innovations)
    return run_filter(model, even_timeline(model, len(readings)), readings, wanted).estimate


class Run(NamedTuple):
    """The result of a forward pass."""

    estimate: Estimate
    determined_row: int  # the first row after the rows that determine the state
    cov: Floats  # (n, n) covariance of the state after the last row, if the state is determined


def run_filter(model: Model, timeline: Timeline, z: Floats, wanted: WantedResults = DEFAULT_RESULTS) -> Run:
    """Filter z (N, m) over a timeline; see `kalman_filter`."""
    kernel, buffers = new_kernel(model, timeline, wanted), new_buffers(model, len(z), wanted)
    kernel.filter(rows_of(timeline, z), buffers)
    return Run(estimate_of(kernel, buffers), int(kernel.head["opened"]), kernel.covariance.copy())


def new_kernel(model: Model, timeline: Timeline, wanted: WantedResults) -> Multivariate:
    """Return a filter before the first row; it starts at x0 and P0, or from a flat prior if there are none.

    Raises
    ------
    ModelError
        If the model is too large, or cannot start without x0 and P0.
    """
    n, m = model.states, model.channels
    if n > MOST_STATES or m > MOST_CHANNELS:
        raise ModelError(
            f"The model has {n} states and {m} channels; up to {MOST_STATES} states and {MOST_CHANNELS} channels are"
            " filtered together. Leave some out, or give independent channels a model each."
        )
    H, R = (np.require(array, np.float64, ["C", "A"]) for array in (timeline.system.H, timeline.system.R))
    x0, P0 = model.x0, model.P0
    enough, prior = COVARIANCE if wanted.covariances else GAIN, wide_prior(model)
    if x0 is not None and P0 is not None and prior is None:
        kernel = Multivariate(H, R, np.zeros((n, n)), np.zeros(n), enough=enough)
        kernel.start(x0, P0)
        return kernel
    refuse_singular(timeline.system)
    root = root_of((prior or flat_prior(model)).Y)
    if x0 is None:
        return Multivariate(H, R, root, np.zeros(n), enough=enough)
    return Multivariate(H, R, root, root @ x0, proper_prior=True, enough=enough)


def rows_of(timeline: Timeline, z: Floats) -> MeasurementRows:
    """Return z (N, m) and the timeline's steps in the layout of the C filter."""
    F, Q = timeline.system.F, timeline.system.Q
    lengths = timeline.lengths if len(timeline.lengths) == len(F) else np.arange(float(len(F)))
    z, F, Q, lengths = (np.require(array, np.float64, ["C", "A"]) for array in (z, F, Q, lengths))
    return MeasurementRows(z, timeline.first, timeline.step, F, Q, lengths)


def new_buffers(model: Model, count: int, wanted: WantedResults) -> EstimateBuffers:
    """Allocate arrays for the requested results of `count` rows."""
    n, m = model.states, model.channels
    flags = (wanted.signal, wanted.sigma, wanted.innovations, wanted.innovations, wanted.states, wanted.covariances)
    shapes = ((count, m),) * 4 + ((count, n), (count, n, n))
    return EstimateBuffers(*(np.empty(shape) if flag else None for flag, shape in zip(flags, shapes, strict=True)))


def sums_of(kernel: Multivariate) -> Sums:
    """Return the terms of the log-likelihood of the filtered rows."""
    head = kernel.head
    log_det = np.log(head["product"]) + head["exponent"] * np.log(2.0)
    return Sums(float(head["squares"]), float(log_det), int(head["used"]))


def estimate_of(kernel: Multivariate, buffers: EstimateBuffers) -> Estimate:
    """Return the results as an `Estimate`; a result that was not requested has no rows, or is None."""
    head = kernel.head
    signal, sigma, innovation, deviation, mean, cov = buffers
    no_rows = np.empty((0, kernel.channels))
    return Estimate(
        signal=no_rows if signal is None else signal,
        sigma=no_rows if sigma is None else sigma,
        log_likelihood=sums_of(kernel).log_likelihood,
        innovations=no_rows if innovation is None else innovation,
        innovation_sigma=no_rows if deviation is None else deviation,
        mean=mean,
        cov=cov,
        used=int(head["used"]),
        settled_row=None if head["settled_row"] < 0 else int(head["settled_row"]),
    )
