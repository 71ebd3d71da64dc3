"""Decide whether rejected readings are outliers or motion.

An outlier stands out from its neighbours, which are calmer.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from becalm.core.arrays import Booleans, Floats

MOSTLY = 0.75
"""Least share of the rejected readings that must stand out from their neighbours."""

_STANDS_OUT = 1.5  # times the local RMS of second differences, which is 2.4 standard deviations for white noise
_NEAR, _FEWEST = 8, 4  # readings on each side; least number of second differences among them


def stand_out(readings: Floats, rejected: Booleans, *, at_jumps: bool = False) -> bool:
    """Return whether most of the rejected readings stand out from their neighbours on both sides.

    Parameters
    ----------
    readings : (N,) float array
        Measurements in the channel's unit, NaN where missing.
    rejected : (N,) bool array
        True where a filter rejected the reading.
    at_jumps : bool
        True if a first reading after a jump may be rejected, as by a filter that waits for the next reading.

    Notes
    -----
    The distance of each rejected reading from the line between the nearest accepted readings is compared with the
    second differences of the accepted readings near it. In a shock, a reversal or an impact the neighbours move as much
    as the rejected reading does. At a jump the neighbours are farther from each other than the rejected reading is from
    one of them.
    """
    seen = np.isfinite(readings)
    z, out = readings[seen], rejected[seen]
    if not out.any():
        return True
    rows, kept = np.flatnonzero(out), np.flatnonzero(~out)
    if len(kept) < 2:
        return False
    after = np.searchsorted(kept, rows)
    last, following = z[kept[np.maximum(after - 1, 0)]], z[kept[np.minimum(after, len(kept) - 1)]]
    nearest = np.minimum(np.abs(z[rows] - last), np.abs(z[rows] - following))
    apart = np.abs(z[rows] - np.interp(rows, kept, z[kept]))
    alone = at_jumps | (nearest > np.abs(following - last))
    return bool(np.mean(alone & (apart > _STANDS_OUT * _roughness(z, out)[rows])) >= MOSTLY)


def _roughness(z: Floats, out: Booleans) -> Floats:
    """Return the RMS (N,) of second differences of the accepted readings near each reading; inf where these are few."""
    bends, valid = np.zeros(len(z)), np.zeros(len(z))
    if len(z) > 2:
        valid[1:-1] = ~(out[:-2] | out[1:-1] | out[2:])
        bends[1:-1] = np.where(valid[1:-1] > 0, np.diff(z, 2) ** 2, 0.0)
    around = [sliding_window_view(np.pad(part, _NEAR), 2 * _NEAR + 1).sum(axis=1) for part in (bends, valid)]
    mean = np.divide(around[0], around[1], out=np.full(len(z), np.inf), where=around[1] >= _FEWEST)
    roughness: Floats = np.sqrt(mean)
    return roughness
