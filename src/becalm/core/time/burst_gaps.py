"""Decide whether the gaps between bursts of stamps are lost rows or come from a driver that waits.

If rows are lost, the other stamps keep the even step of the sensor, and each gap is a whole number of steps. If a
driver waits and then stamps all rows that it fetches, the gaps are independent of the steps within its bursts.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats

_INSTANT = 0.5  # of the mean step: shorter bursts count as one instant, even if their stamps are uneven
_EVEN = 0.2  # std of the steps within bursts over their mean: up to it their step can be estimated
_SIGMAS = 5.0  # of the mean cosine of gap / step, which is 1 if all gaps are whole steps, and 0 for random gaps
_PER_CYCLE = 8  # candidate steps per cycle of a long gap
_MOST_GAPS, _MOST_CANDIDATES = 4096, 1000


def rows_lost_between(steps: Floats, apart_s: float) -> bool:
    """Return whether the gaps between bursts may be lost rows of a sensor with an even step.

    Parameters
    ----------
    steps : (n,) float array
        Differences of consecutive stamps, in seconds.
    apart_s : float
        Steps longer than this are gaps between bursts.

    Returns
    -------
    bool
        True if the gaps are whole numbers of the even step within bursts, or if the stamps within bursts are
        neither even nor at one instant.
    """
    within, gaps = steps[steps <= apart_s], steps[steps > apart_s]
    middle = float(np.median(within)) if len(within) else 0.0
    if not middle > 0.0 or not len(gaps):
        return False  # all stamps of a burst are at one instant
    near = within[np.abs(within - middle) <= 0.5 * middle]
    step, spread = float(near.mean()), float(near.std())
    if spread > _EVEN * step:
        return float(within.sum()) > _INSTANT * float(steps.mean()) * len(gaps)
    gaps = gaps[:: -(-len(gaps) // _MOST_GAPS)]
    error = 4.0 * spread / np.sqrt(len(near))
    cycles = 2.0 * error * float(np.quantile(gaps, 0.9)) / step**2
    candidates = step + error * np.linspace(-1.0, 1.0, int(np.clip(_PER_CYCLE * cycles, 1, _MOST_CANDIDATES)) | 1)
    wholeness = max(float(np.cos(2.0 * np.pi * gaps / one).mean()) for one in candidates)
    return bool(wholeness > _SIGMAS / np.sqrt(2.0 * len(gaps)))
