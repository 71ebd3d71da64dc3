"""Fill missing readings for filters that need complete records: hold the last reading, or interpolate linearly."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats


def hold_last(z: Floats) -> Floats:
    """Return readings (N,) with NaN replaced by the last reading before, and at the start by the first reading."""
    finite = np.flatnonzero(np.isfinite(z))
    if len(finite) == len(z) or not len(finite):
        return z
    latest = np.searchsorted(finite, np.arange(len(z)), side="right") - 1
    return np.asarray(z[finite[np.maximum(latest, 0)]])


def interpolate_linearly(z: Floats) -> Floats:
    """Return readings (N,) with NaN replaced by linear interpolation, and at the ends by the nearest reading."""
    finite = np.flatnonzero(np.isfinite(z))
    if len(finite) == len(z) or not len(finite):
        return z
    return np.interp(np.arange(len(z)), finite, z[finite])
