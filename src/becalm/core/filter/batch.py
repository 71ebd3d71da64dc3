"""Filter many records with one model, one record after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, Integers
from becalm.core.filter.filtering import (
    WantedResults,
    new_buffers,
    new_kernel,
    numbers,
    require_model,
    rows_of,
    sums_of,
)
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import even_timeline
from becalm.errors import ModelError
from becalm.native.multivariate import EstimateBuffers


@dataclass(frozen=True)
class FilteredBatch:
    """The result of a filter for B records of N readings, m channels and n states.

    Attributes
    ----------
    signal, sigma : (B, N, m) float array
        H x and its standard uncertainty, in the channels' units.
    innovations, innovation_sigma : (B, N, m) float array
        Reading minus its prediction, and the expected standard deviation of this difference; without rows if they were
        not requested.
    mean : (B, N, n) float array or None
        Filtered states, on request.
    log_likelihood : (B,) float array
        Exact Gaussian log-likelihood of each record.
    used : (B,) int array
        Number of readings in the log-likelihood of each record.
    """

    signal: Floats
    sigma: Floats
    innovations: Floats
    innovation_sigma: Floats
    mean: Floats | None
    log_likelihood: Floats
    used: Integers


def filter_batch(model: Model, z: ArrayLike, *, states: bool = False, innovations: bool = True) -> FilteredBatch:
    """Filter many records causally, each as `kalman_filter` would.

    Parameters
    ----------
    model : Model
        Model of the signal and its sensors, one step per row, the same for all records.
    z : (B, N, m) array_like
        Readings in the channels' units, NaN where a reading is missing. The array is not modified.
    states, innovations : bool
        Whether to return `mean`, and `innovations` with `innovation_sigma`.

    Raises
    ------
    ModelError
        If z does not fit the model, or the model cannot start without x0 and P0.
    """
    require_model(model)
    readings = np.require(numbers(z), requirements=["C", "A"])
    if readings.ndim != 3 or readings.shape[2] != model.channels:
        raise ModelError(f"z has shape {np.shape(z)}; (records, N, {model.channels}) is needed.")
    wanted, records, count = WantedResults(states=states, innovations=innovations), *readings.shape[:2]
    timeline = even_timeline(model, count)
    kernel = new_kernel(model, timeline, wanted)
    start, likelihoods, used = kernel.state.copy(), np.empty(records), np.empty(records, np.int64)
    results = EstimateBuffers(
        *(None if array is None else np.empty((records, *array.shape)) for array in new_buffers(model, count, wanted))
    )
    for record, z_k in enumerate(readings):
        kernel.state[:] = start
        kernel.filter(
            rows_of(timeline, z_k), EstimateBuffers(*(None if array is None else array[record] for array in results))
        )
        sums = sums_of(kernel)
        likelihoods[record], used[record] = sums.log_likelihood, sums.used
    no_rows = np.empty((records, 0, model.channels))
    signal, sigma, innovation, deviation, mean, _ = (no_rows if array is None else array for array in results)
    return FilteredBatch(signal, sigma, innovation, deviation, mean if states else None, likelihoods, used)
