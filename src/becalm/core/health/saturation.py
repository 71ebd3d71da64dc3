"""Find the saturation limits of a sensor: extreme readings that are far more frequent than a signal makes them.

A signal rarely reaches its extremes: the most extreme codes of white noise are the rarest, and a smooth peak holds its
last code at most about four times as long as each of the ten codes before it. A saturated sensor returns its limit for
all values beyond the limit. A record cannot distinguish a limit from a level that the signal keeps without noise. So
there is no search in a record without visible noise or with only a few codes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Floats, Integers

_FEWEST_CODES = 16  # with fewer codes the extreme code is not rare
_NEIGHBOURS = 10  # number of different readings next to the extreme reading
_OFTENER = 8  # least count of a limit, over the mean count of these neighbours; a smooth peak has up to 4.3
_THAN_NEXT = 4  # least count of a limit, over that of the next reading; a peak has up to 2.4, a level between codes 1
_TURNS_BACK = 0.22  # least share of steps that change direction: that of white noise with a sigma of 1/3 code
_ROUGH = 0.4  # least standard deviation of noise, in codes; the rounding of a moving signal has 0.29
_FOURTH = 0.6745 * np.sqrt(70.0)  # median of the fourth differences of white noise of variance 1


class SaturationLimits(NamedTuple):
    """The lowest and the highest reading of a sensor, in unit; -inf and inf where unknown."""

    low: float = -np.inf
    high: float = np.inf

    def reached(self, z: Floats) -> Booleans:
        """Return which readings (N,) are at a saturation limit or beyond."""
        return np.asarray((z <= self.low) | (z >= self.high))


def find_saturation(z: Floats, resolution: float) -> SaturationLimits:
    """Find the saturation limits of a channel.

    Parameters
    ----------
    z : (N,) float array
        Finite readings, in unit, in order, without duplicate rows.
    resolution : float
        The step between two codes, in unit; 0 if there is none.

    Returns
    -------
    SaturationLimits
        The limits that the record reached at least twice. Smooth clipping, and clipping before noise is added, repeat
        no reading and are not detected. Clipping at 0 is not reported, because speeds and loads rest there.
    """
    values, counts = np.unique(z, return_counts=True)
    if len(values) < _FEWEST_CODES or not is_noisy(z[(z > values[0]) & (z < values[-1])], resolution):
        return SaturationLimits()
    low, high = float(values[0]), float(values[-1])
    return SaturationLimits(
        low if low != 0 and _is_piled_up(counts) and _comes_back(z == low) else -np.inf,
        high if high != 0 and _is_piled_up(counts[::-1]) and _comes_back(z == high) else np.inf,
    )


def _is_piled_up(counts: Integers) -> bool:
    """Return whether the first count is far above those of the next readings; counts are in the order of readings."""
    neighbours = counts[1 : 1 + _NEIGHBOURS]
    return bool(counts[0] >= max(_OFTENER * neighbours.mean(), _THAN_NEXT * neighbours[0]))


def _comes_back(at_extreme: Booleans) -> bool:
    """Return whether the record reaches an extreme more than once, and at least once for several readings in a row."""
    visits = int(at_extreme[0]) + int(np.count_nonzero(at_extreme[1:] & ~at_extreme[:-1]))
    return 1 < visits < int(np.count_nonzero(at_extreme))


def is_noisy(z: Floats, resolution: float) -> bool:
    """Return whether readings (N,) have enough noise that they cannot stay at one level or code.

    Noise often changes the direction of the steps. In a fast signal, noise makes the fourth differences larger than
    rounding does.
    """
    if len(z) < _FEWEST_CODES:
        return False
    steps = np.diff(z)
    moves = np.sign(steps[steps != 0])
    turns = int(np.count_nonzero(moves[1:] != moves[:-1]))
    rough = float(np.median(np.abs(np.diff(z, 4)))) / _FOURTH
    least = _ROUGH * resolution if resolution > 0 else 1e-9 * float(np.ptp(z))
    return turns >= _TURNS_BACK * len(steps) or rough > least
