"""The value that a log writes where there is no reading."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Booleans, Floats, Integers

_FEWEST, _SHARE = 20, 0.05  # of the readings that are blank
_FEWEST_VALUES = 16
_OFTENER, _BESIDE = 10.0, 5  # than so many values on each side of it
_RUN = 3  # rows that most runs of it are long, at the most
_NOISES, _SPREADS = 4.0, 2.0  # how far it mostly is from readings around it: times their noise, and their distance
_OF_NOISE = 0.6745 * np.sqrt(2.0)  # median distance of two readings, of white noise of variance 1


def find_blank(z: Floats) -> float:
    """Return the value that fills in for readings that are missing, one row here and one there; inf if none does.

    It comes far more often than values beside it, and readings before and after it agree, mostly without it.

    Parameters
    ----------
    z : (N,) float array
        Finite readings, in unit, in order.
    """
    values, counts = np.unique(z, return_counts=True)
    if len(values) < _FEWEST_VALUES:
        return np.inf
    place = int(counts.argmax())
    blank, count = float(values[place]), int(counts[place])
    beside = np.delete(counts[max(place - _BESIDE, 0) : place + _BESIDE + 1], min(place, _BESIDE))
    if count < max(_FEWEST, _SHARE * len(z), _OFTENER * float(np.median(beside))):
        return np.inf
    first, last = _runs_inside(z == blank)
    if not len(first) or np.quantile(last - first + 1, 0.9) > _RUN:
        return np.inf
    steps = np.abs(np.diff(z[z != blank]))
    noise = float(np.median(steps[steps > 0])) / _OF_NOISE if (steps > 0).any() else np.inf
    before, after = z[first - 1], z[last + 1]
    least = np.maximum(_SPREADS * np.abs(after - before), _NOISES * noise)
    return blank if np.mean(np.abs(blank - (before + after) / 2) > least) > 0.5 else np.inf


def _runs_inside(there: Booleans) -> tuple[Integers, Integers]:
    """Return the first and the last rows of runs that neither begin nor end a record (N,)."""
    edges = np.diff(there.astype(np.int8), prepend=0, append=0)
    first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    inner = (first > 0) & (last < len(there) - 1)
    return first[inner], last[inner]
