"""Missing readings before a filter that knows none: the last one is held, or neighbours are joined by a line."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats


def held(z: Floats) -> Floats:
    """Return readings (N,) with the last one held where there is none; before the first, the first."""
    known = np.flatnonzero(np.isfinite(z))
    if len(known) == len(z) or not len(known):
        return z
    places = np.searchsorted(known, np.arange(len(z)), side="right") - 1
    return np.asarray(z[known[np.maximum(places, 0)]])


def joined_by_lines(z: Floats) -> Floats:
    """Return readings (N,) with neighbours joined by a line where there is none; before and after all, held."""
    known = np.flatnonzero(np.isfinite(z))
    if len(known) == len(z) or not len(known):
        return z
    return np.interp(np.arange(len(z)), known, z[known])
