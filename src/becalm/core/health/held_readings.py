"""Detect channels that repeat their last reading while there is no new one: a slow sensor in a fast log, or lost rows.

With noise, two consecutive readings are equal about as often as they differ by one code, (N(+1) + N(-1)) / 2 times. A
coarse converter at rest has more equal readings, but leaves its code by a step of one code. After a repeated reading
the step is as large as the steps between single readings.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.health.saturation import is_noisy

_FEWEST = 30  # least number of runs; a single reading is also a run
_FEWEST_REPEATED = 10  # least number of runs of equal readings; this many of the longest runs may be rests or faults
_SHARE = 0.05  # least share of readings that equal the previous reading
_SMALLEST = 0.01  # the median of this share of the smallest steps is about one code
_ONE_CODE = 1.5  # a step of up to this many codes counts as one code
_OFTENER = 3.0  # least number of equal consecutive readings, over the number expected by chance
_CODES = 3.0  # least median step between different readings, in codes
_MOST_ALIKE = 0.25  # largest share of runs with the same value
_SINGLE = 0.1  # least share of single readings among the runs, for a comparison with the steps between them
_LIKE_SINGLES = 0.5  # least step at the end of a run, over the median step of single readings
_REGULAR = 1.5  # largest ratio of a long run to a short run, for a sensor that is slower than its log


def repeats_readings(z: Floats, resolution: float) -> bool:
    """Return whether a channel repeats its last reading while there is no new one.

    Parameters
    ----------
    z : (N,) float array
        Finite readings, in unit, in order.
    resolution : float
        The step between two codes, in unit; 0 if there is none.
    """
    changes = np.flatnonzero(np.append(z[1:] != z[:-1], True)) if len(z) else np.empty(0, np.int64)
    values, lengths = z[changes], np.diff(changes, prepend=-1)
    if len(values) < _FEWEST or np.count_nonzero(lengths > 1) < _FEWEST_REPEATED:
        return False
    steps = np.abs(np.diff(values))
    code = max(resolution, float(np.quantile(steps, _SMALLEST / 2)))
    chance = np.count_nonzero(steps <= _ONE_CODE * code) / 2
    usual = np.sort(lengths)[:-_FEWEST_REPEATED]
    many = int(usual.sum()) - len(usual) > max(_OFTENER * chance, _SHARE * len(z))
    coarse = resolution > 0 and float(np.median(steps)) < _CODES * resolution
    if not many or coarse or not is_noisy(values, resolution):
        return False
    run_values = values[lengths > 1]
    if np.unique(run_values, return_counts=True)[1].max() > _MOST_ALIKE * len(run_values):
        return False
    return _is_like_singles(steps, lengths) if np.mean(lengths == 1) >= _SINGLE else _is_regular(lengths)


def _is_like_singles(steps: Floats, lengths: Integers) -> bool:
    """Return whether runs end with steps as large as those between single readings."""
    single = (lengths[1:] == 1) & (lengths[:-1] == 1)
    ends = steps[lengths[:-1] > 1]
    return bool(single.any() and len(ends) and np.median(ends) >= _LIKE_SINGLES * np.median(steps[single]))


def _is_regular(lengths: Integers) -> bool:
    """Return whether nearly all runs have the same length."""
    short, long = np.quantile(lengths, (0.1, 0.9))
    return bool(long <= max(_REGULAR * short, short + 1))
