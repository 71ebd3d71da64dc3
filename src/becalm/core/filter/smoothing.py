"""Smooth a record: every estimate uses all readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import (
    DEFAULT_RESULTS,
    Estimate,
    WantedResults,
    checked_readings,
    estimate_of,
    new_buffers,
    new_kernel,
    rows_of,
)
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import Timeline, even_timeline


def kalman_smoother(  # noqa: PLR0913  (one flag for each result)
    model: Model,
    z: ArrayLike,
    *,
    states: bool = False,
    covariances: bool = False,
    sigma: bool = True,
    innovations: bool = True,
) -> Estimate:
    """Smooth readings: each estimate uses the whole record, before and after its own row.

    Parameters
    ----------
    model : Model
        Model of the signal and its sensors, one step per row.
    z : (N,) or (N, m) array_like
        Readings in the channels' units; NaN or Inf where a reading is missing. The array is not modified.
    states, covariances : bool
        Whether to return `mean` (N, n) and `cov` (N, n, n).
    sigma, innovations : bool
        Whether to return `sigma`, and `innovations` with `innovation_sigma`; without them the smoother is faster.
        `covariances` implies `sigma`.

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
    The smoother is that of Bryson and Frazier (1963) in Bierman's form (1973), equations (9) to (12) of
    `becalm.core.reference.kalman`. It gives the same result as that of Rauch, Tung and Striebel (1965), without
    the inverse of a covariance. With a flat prior the mean is that of penalised least squares.
    """
    readings = checked_readings(model, z)
    wanted = WantedResults(states, covariances, sigma or covariances, innovations)
    return run_smoother(model, even_timeline(model, len(readings)), readings, wanted)


def run_smoother(model: Model, timeline: Timeline, z: Floats, wanted: WantedResults = DEFAULT_RESULTS) -> Estimate:
    """Smooth z (N, m) over a timeline; see `kalman_smoother`."""
    kernel, buffers = new_kernel(model, timeline, wanted), new_buffers(model, len(z), wanted)
    innovation = np.empty(z.shape) if buffers.innovation is None else buffers.innovation
    kernel.smooth(rows_of(timeline, z), buffers._replace(innovation=innovation))
    return estimate_of(kernel, buffers)
