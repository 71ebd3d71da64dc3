"""Fixed-lag smoothing: each row is estimated from all rows up to L after it.

Between the filter (L = 0) and the smoother (all rows): a little delay buys much noise. The estimate of row k
is that of `kalman_smoother` on the record that ends with row k + L.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import checked_readings, kalman_filter
from becalm.core.filter.lag import checked_lag
from becalm.core.model.model import Model
from becalm.core.online import Online


def fixed_lag_smoother(model: Model, z: ArrayLike, lag: int) -> tuple[Floats, Floats]:
    """Smooth readings with a fixed lag: each estimate knows the readings up to `lag` rows after its own.

    Parameters
    ----------
    model : Model
        The signal and its sensors, one step a row.
    z : (N,) or (N, m) array_like
        Readings in the channels' units; NaN or Inf where one did not arrive. Never modified.
    lag : int
        Later rows that are waited for; with a *small* one the signal comes soon, and noisier. 0 filters.

    Returns
    -------
    signal, sigma : (N, m) float arrays
        H x, and one standard uncertainty of it, in the channels' units. The last `lag` rows know what there is.

    Raises
    ------
    ModelError
        If z does not fit the model, the lag is no whole number, or the model cannot start without x0 and P0.
    """
    readings = checked_readings(model, z)
    if checked_lag(lag) == 0:
        found = kalman_filter(model, readings, innovations=False)
        return found.signal, found.sigma
    online, waited = Online(model, lag), min(lag, len(readings))
    told, rest = online.run(readings), online.finish()
    signal, sigma = (np.concatenate([one[waited:], last]) for one, last in zip(told, rest, strict=True))
    return signal, sigma
