"""Readings that repeat the one before because no new one came: of a sensor that is slower than its log, or lost rows.

The noise of a sensor brings equal neighbours about as often as neighbours one code apart, (N(+1) + N(-1)) / 2. A coarse
converter at rest has more of them, but leaves its code by a step of one; a reading that is held ends with a step as
large as the noise of single readings.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.health.saturation import is_noisy

_FEWEST = 30  # different readings, one after the other
_FEWEST_HELD = 10  # runs of equal readings: so many, the longest, are rests, or faults of the sensor
_SHARE = 0.05  # of the readings that repeat the one before
_SMALLEST, _BESIDE = (
    0.01,
    1.5,
)  # share of steps whose median is about one code, and codes up to which steps are so small
_OFTENER = 3.0  # than chance brings equal neighbours
_CODES = 3.0  # that a step between different readings has, at the median
_MOST_ALIKE = 0.25  # share of the runs that hold the same value
_SINGLE = 0.1  # share of runs that are one reading long, from which on they show how large steps are
_LIKE_SINGLES = 0.5  # times their median step, for a run's end to be like them
_REGULAR = 1.5  # ratio of long runs to short ones, of a sensor that is slower than its log


def repeats_readings(z: Floats, resolution: float) -> bool:
    """Return whether a channel repeats its last reading where no new one came.

    Parameters
    ----------
    z : (N,) float array
        Finite readings, in unit, in order.
    resolution : float
        The step between two codes, in unit; 0 where there is none.
    """
    changes = np.flatnonzero(np.append(z[1:] != z[:-1], True)) if len(z) else np.empty(0, np.int64)
    values, lengths = z[changes], np.diff(changes, prepend=-1)
    if len(values) < _FEWEST or np.count_nonzero(lengths > 1) < _FEWEST_HELD:
        return False
    steps = np.abs(np.diff(values))
    code = max(resolution, float(np.quantile(steps, _SMALLEST / 2)))
    chance = np.count_nonzero(steps <= _BESIDE * code) / 2
    usual = np.sort(lengths)[:-_FEWEST_HELD]
    many = int(usual.sum()) - len(usual) > max(_OFTENER * chance, _SHARE * len(z))
    coarse = resolution > 0 and float(np.median(steps)) < _CODES * resolution
    if not many or coarse or not is_noisy(values, resolution):
        return False
    held = values[lengths > 1]
    if np.unique(held, return_counts=True)[1].max() > _MOST_ALIKE * len(held):
        return False
    return _is_like_singles(steps, lengths) if np.mean(lengths == 1) >= _SINGLE else _is_regular(lengths)


def _is_like_singles(steps: Floats, lengths: Integers) -> bool:
    """Return whether runs end with a step as large as those between single readings."""
    single = (lengths[1:] == 1) & (lengths[:-1] == 1)
    ends = steps[lengths[:-1] > 1]
    return bool(single.any() and len(ends) and np.median(ends) >= _LIKE_SINGLES * np.median(steps[single]))


def _is_regular(lengths: Integers) -> bool:
    """Return whether nearly all runs are as long."""
    short, long = np.quantile(lengths, (0.1, 0.9))
    return bool(long <= max(_REGULAR * short, short + 1))
