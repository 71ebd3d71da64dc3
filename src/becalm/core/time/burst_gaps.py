"""What lies between bursts of stamps: a driver's waiting, or rows that were lost.

Where rows are lost, the stamps left over keep the even step of the sensor, and each gap is whole steps of it. A
driver that waits, and then stamps what it fetches, leaves gaps that have nothing to do with the steps in its bursts.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats

_INSTANT = 0.5  # of the mean step: bursts that last no longer are of one instant, however unevenly their stamps lie
_EVEN = 0.2  # std of steps within bursts, of their mean: where they lie so, a grid of them can be told
_SIGMAS = 5.0  # of the mean cosine of gaps over the step, which is 1 where all are whole, and 0 where none is
_FINE = 8  # candidates a cycle of a long gap
_MOST_GAPS, _MOST_CANDIDATES = 4096, 1000


def rows_lost_between(steps: Floats, apart_s: float) -> bool:
    """Tell whether bursts may be what is left of even rows.

    Parameters
    ----------
    steps : (n,) float array
        From stamp to stamp, in seconds.
    apart_s : float
        Longer steps are between bursts.

    Returns
    -------
    bool
        Whether the gaps are whole steps of the even rows in bursts, or these are neither even nor of
        one instant.
    """
    within, gaps = steps[steps <= apart_s], steps[steps > apart_s]
    middle = float(np.median(within)) if len(within) else 0.0
    if not middle > 0.0 or not len(gaps):
        return False  # of one instant
    near = within[np.abs(within - middle) <= 0.5 * middle]
    step, spread = float(near.mean()), float(near.std())
    if spread > _EVEN * step:
        return float(within.sum()) > _INSTANT * float(steps.mean()) * len(gaps)
    gaps = gaps[:: -(-len(gaps) // _MOST_GAPS)]
    error = 4.0 * spread / np.sqrt(len(near))
    cycles = 2.0 * error * float(np.quantile(gaps, 0.9)) / step**2
    candidates = step + error * np.linspace(-1.0, 1.0, int(np.clip(_FINE * cycles, 1, _MOST_CANDIDATES)) | 1)
    wholeness = max(float(np.cos(2.0 * np.pi * gaps / one).mean()) for one in candidates)
    return bool(wholeness > _SIGMAS / np.sqrt(2.0 * len(gaps)))
