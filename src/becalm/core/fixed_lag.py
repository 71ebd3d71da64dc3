"""Fixed-lag smoothing: each row is estimated from all rows up to L rows after it.

With L = 0 the result is that of the filter, and with L as long as the record it is that of the smoother. The estimate
of row k equals that of `kalman_smoother` on the record that ends with row k + L.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import checked_readings, kalman_filter
from becalm.core.filter.fixed_lag_flow import checked_lag
from becalm.core.model.model import Model
from becalm.core.online import Online


def fixed_lag_smoother(model: Model, z: ArrayLike, lag: int) -> tuple[Floats, Floats]:
    """Smooth readings with a fixed lag: each estimate uses the readings up to `lag` rows after its own row.

    Parameters
    ----------
    model : Model
        State-space model of the signal and its sensors, one step per row.
    z : (N,) or (N, m) array_like
        Readings in the channels' units; NaN or Inf where a reading is missing. The array is not modified.
    lag : int
        Lag in rows. A *small* lag gives estimates earlier and with more noise; 0 is the filter.

    Returns
    -------
    signal, sigma : (N, m) float arrays
        H x and its standard uncertainty, in the channels' units. The last `lag` rows use the readings up to the end.

    Raises
    ------
    ModelError
        If z does not fit the model, the lag is not a whole number, or the model cannot start without x0 and P0.
    """
    readings = checked_readings(model, z)
    if checked_lag(lag) == 0:
        filtered = kalman_filter(model, readings, innovations=False)
        return filtered.signal, filtered.sigma
    online, delay = Online(model, lag), min(lag, len(readings))
    estimates, remaining = online.run(readings), online.finish()
    signal, sigma = (np.concatenate([early[delay:], late]) for early, late in zip(estimates, remaining, strict=True))
    return signal, sigma
