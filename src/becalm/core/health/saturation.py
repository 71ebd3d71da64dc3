"""Where a sensor's range ends: extreme readings that come back far oftener than a signal would bring them.

A signal passes its extremes seldom: of the codes of a white noise the last are the rarest, and a smooth
peak holds its last code no more than four times as long as each of the ten before. A rail holds all that would
have been beyond. What no record tells is a rail from a level that the signal itself keeps without noise: so
none is looked for where no noise is seen, nor where there are only a few codes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Floats, Integers

_FEWEST_CODES = 16  # fewer have no end that is rare
_BESIDE = 10  # different readings beside the extreme one
_OFTENER = 8  # than those: a smooth peak holds its last code up to 4.3 times as often ...
_THAN_NEXT = 4  # ... and 2.4 times as often as the next; a level between two codes, as often
_TURNS_BACK = 0.22  # of all steps: white noise a third of a code wide turns back as often, one of a fifth does not
_ROUGH = 0.4  # of a code; the rounding of a moving signal alone is 0.29
_FOURTH = 0.6745 * np.sqrt(70.0)  # median of the fourth differences of white noise of variance 1


class SaturationLimits(NamedTuple):
    """The lowest and the highest reading a sensor gives, in unit; -inf and inf where none is known."""

    low: float = -np.inf
    high: float = np.inf

    def reached(self, z: Floats) -> Booleans:
        """Tell which readings (N,) are at a rail or beyond."""
        return np.asarray((z <= self.low) | (z >= self.high))


def find_saturation(z: Floats, resolution: float) -> SaturationLimits:
    """Find the rails of a channel.

    Parameters
    ----------
    z : (N,) float array
        Finite readings, in unit, in order, none of them written twice.
    resolution : float
        The step between two codes, in unit; 0 if there is none.

    Returns
    -------
    SaturationLimits
        Those that were reached at least twice in the record. A clipping that is smooth, or has noise of its
        own behind it, repeats no reading and is not found; nor is one at 0, where speeds and loads rest.
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
    """Return whether the first of the counts of different readings is far above those beside it."""
    beside = counts[1 : 1 + _BESIDE]
    return bool(counts[0] >= max(_OFTENER * beside.mean(), _THAN_NEXT * beside[0]))


def _comes_back(there: Booleans) -> bool:
    """Return whether an extreme is held for two readings or more, and reached more than once."""
    visits = int(there[0]) + int(np.count_nonzero(there[1:] & ~there[:-1]))
    return 1 < visits < int(np.count_nonzero(there))


def is_noisy(z: Floats, resolution: float) -> bool:
    """Return whether readings (N,) show a noise that no level, and no code, would be kept through.

    Noise turns back; where a signal moves faster than that, its fourth differences are rougher than rounding.
    """
    if len(z) < _FEWEST_CODES:
        return False
    steps = np.diff(z)
    moves = np.sign(steps[steps != 0])
    turns = int(np.count_nonzero(moves[1:] != moves[:-1]))
    rough = float(np.median(np.abs(np.diff(z, 4)))) / _FOURTH
    least = _ROUGH * resolution if resolution > 0 else 1e-9 * float(np.ptp(z))
    return turns >= _TURNS_BACK * len(steps) or rough > least
