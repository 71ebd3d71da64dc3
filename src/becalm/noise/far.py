"""Readings so far out that they are not even spikes to tune by: a broken digit, a value for "none", a spark.

One reading of 10^6 sigma outweighs all others in any sum of squares. Far out is what stands a thousand times further
from the median of five neighbours than most readings do; a peak of motion has neighbours that lead there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from becalm.core.arrays import Floats

FAR = 1000.0
"""Times the distance that half of the readings keep from the median of their neighbours."""

WINDOW = 5
"""Readings whose median is taken: two that are far out side by side are still the fewer."""
_MOST = 0.1  # share of the readings beyond which they are no exceptions
_PIECE = 1 << 16


class Far(NamedTuple):
    """How many readings of a record are far out, and how far."""

    share: float = 0.0  # of the readings
    reach: float = 0.0  # from the lowest to the highest of all, in unit


NONE_FAR = Far()


def told_of_far(readings: Floats, tame: Floats) -> Far:
    """Return what `without_far` replaced, from readings (N,) before it and after."""
    seen = readings[np.isfinite(readings)]
    replaced = np.count_nonzero((readings != tame) & np.isfinite(readings))
    return Far(replaced / len(seen), float(np.ptp(seen))) if len(seen) else NONE_FAR


def without_far(readings: Floats) -> Floats:
    """Return readings (N,) with each that is far out replaced by the median of its neighbours.

    Parameters
    ----------
    readings : (N,) float array
        In the channel's unit, NaN where missing; they come back as they are where none is far out.
    """
    seen = np.flatnonzero(np.isfinite(readings))
    if len(seen) < WINDOW:
        return readings
    z = readings[seen]
    middle = running_median(z)
    apart = np.abs(z - middle)
    for end, own in ((z, apart), (z[::-1], apart[::-1])):  # where motion leads there from one side only
        for row in range(WINDOW // 2):
            a, b, c, d = end[row : row + 4]
            own[row] = min(own[row], abs(a - 2 * b + c), abs(a - 3 * c + 2 * d), abs(a - 3 * b + 3 * c - d))
    if not apart.any():
        return readings
    far = apart > FAR * float(np.median(apart[apart > 0]))
    if not 0 < np.count_nonzero(far) <= _MOST * len(z):
        return readings
    tame = readings.copy()
    tame[seen[far]] = middle[far]
    return tame


def running_median(z: Floats) -> Floats:
    """Return the median of five neighbours of each of z (N,), N at least 5; at the ends, of the five there."""
    half, inner = WINDOW // 2, np.empty(len(z) - WINDOW + 1)
    for start in range(0, len(inner), _PIECE):
        windows = sliding_window_view(z[start : start + _PIECE + WINDOW - 1], WINDOW)
        inner[start : start + _PIECE] = np.median(windows, axis=1)
    return np.pad(inner, half, mode="edge")
