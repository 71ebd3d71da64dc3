"""Compute only the log-likelihood of a record; for one channel see also `ChannelRecord.score`."""

from __future__ import annotations

from numpy.typing import ArrayLike

from becalm.core.filter.filtering import WantedResults, checked_readings, run_filter
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import even_timeline

LIKELIHOOD_ONLY = WantedResults(sigma=False, innovations=False, signal=False)


def log_likelihood(model: Model, z: ArrayLike) -> float:
    """Return the exact Gaussian log-likelihood of readings; see `kalman_filter`.

    Parameters
    ----------
    model : Model
        Model of the signal and its sensors, one step per row.
    z : (N,) or (N, m) array_like
        Readings in the channels' units, NaN where a reading is missing.

    Raises
    ------
    ModelError
        If z does not fit the model, or the model cannot start without x0 and P0.

    Notes
    -----
    Schweppe, IEEE TIT-11 (1965) 61; equation (8) of `becalm.core.reference.kalman`.
    """
    readings = checked_readings(model, z)
    return run_filter(model, even_timeline(model, len(readings)), readings, LIKELIHOOD_ONLY).estimate.log_likelihood
