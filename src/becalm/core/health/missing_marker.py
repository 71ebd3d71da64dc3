"""Find the value that marks missing readings in a log."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Booleans, Floats, Integers

_FEWEST, _SHARE = 20, 0.05  # least number and share of readings that have the marker
_FEWEST_VALUES = 16  # least number of different readings
_OFTENER, _NEIGHBOURS = 10.0, 5  # how often it comes, over the median of this many values on each side
_RUN = 3  # rows: most runs of the marker are no longer
_NOISES, _SPREADS = 4.0, 2.0  # least distance from readings around it, over their noise and over their difference
_OF_NOISE = 0.6745 * np.sqrt(2.0)  # median distance of two readings, for white noise of variance 1


def find_blank(z: Floats) -> float:
    """Return the value that stands in for single missing readings; inf if there is none.

    It comes far more often than neighbouring values. The readings before and after it agree mostly with each other, and
    not with it.

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
    neighbours = np.delete(counts[max(place - _NEIGHBOURS, 0) : place + _NEIGHBOURS + 1], min(place, _NEIGHBOURS))
    if count < max(_FEWEST, _SHARE * len(z), _OFTENER * float(np.median(neighbours))):
        return np.inf
    first, last = _runs_inside(z == blank)
    if not len(first) or np.quantile(last - first + 1, 0.9) > _RUN:
        return np.inf
    steps = np.abs(np.diff(z[z != blank]))
    noise = float(np.median(steps[steps > 0])) / _OF_NOISE if (steps > 0).any() else np.inf
    before, after = z[first - 1], z[last + 1]
    least = np.maximum(_SPREADS * np.abs(after - before), _NOISES * noise)
    return blank if np.mean(np.abs(blank - (before + after) / 2) > least) > 0.5 else np.inf


def _runs_inside(is_marker: Booleans) -> tuple[Integers, Integers]:
    """Return the first and the last rows of runs of True (N,) that touch neither end of the record."""
    edges = np.diff(is_marker.astype(np.int8), prepend=0, append=0)
    first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    inner = (first > 0) & (last < len(is_marker) - 1)
    return first[inner], last[inner]
