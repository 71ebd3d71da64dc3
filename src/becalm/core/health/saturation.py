"""Find the saturation limits of a sensor: extreme readings that come far more often than a signal would reach them.

A signal rarely reaches its extremes: the last codes of white noise are the rarest, and a smooth peak holds its last
code at most about four times as long as each of the ten codes before. A saturated sensor shows its limit for everything
beyond. A record cannot distinguish a limit from a level that the signal keeps without noise. So the search is skipped
for a record without visible noise, or with only a few codes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Floats, Integers

_FEWEST_CODES = 16  # with fewer codes the last one is not rare
_NEIGHBOURS = 10  # different readings next to the extreme one
_OFTENER = 8  # least count of the extreme, over the mean count of these; up to 4.3 for a smooth peak ...
_THAN_NEXT = 4  # ... and over the count of the next one; up to 2.4 for a smooth peak, 1 for a level between two codes
_TURNS_BACK = 0.22  # least share of steps that turn back: white noise of 1/3 code has it, noise of 1/5 code has less
_ROUGH = 0.4  # codes: least standard deviation of noise; rounding of a moving signal alone has 0.29
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
        The limits that the record reached at least twice. Smooth clipping, or clipping before a source of noise,
        repeats no reading and is not detected. Neither is clipping at 0, where speeds and loads rest.
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
    """Return whether the first of the counts of different readings is far above the next ones."""
    neighbours = counts[1 : 1 + _NEIGHBOURS]
    return bool(counts[0] >= max(_OFTENER * neighbours.mean(), _THAN_NEXT * neighbours[0]))


def _comes_back(at_extreme: Booleans) -> bool:
    """Return whether the record reaches an extreme more than once, and once for two readings or more."""
    visits = int(at_extreme[0]) + int(np.count_nonzero(at_extreme[1:] & ~at_extreme[:-1]))
    return 1 < visits < int(np.count_nonzero(at_extreme))


def is_noisy(z: Floats, resolution: float) -> bool:
    """Return whether readings (N,) show enough noise that they cannot stay on one level or one code.

    Noise often turns back. In a fast signal it makes the fourth differences rougher than rounding alone.
    """
    if len(z) < _FEWEST_CODES:
        return False
    steps = np.diff(z)
    moves = np.sign(steps[steps != 0])
    turns = int(np.count_nonzero(moves[1:] != moves[:-1]))
    rough = float(np.median(np.abs(np.diff(z, 4)))) / _FOURTH
    least = _ROUGH * resolution if resolution > 0 else 1e-9 * float(np.ptp(z))
    return turns >= _TURNS_BACK * len(steps) or rough > least
