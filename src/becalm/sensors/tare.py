"""The zero of a sensor, from a stretch without load that is checked to be quiet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.verdict import BEYOND_ANY_SENSOR
from becalm.errors import SensorError

BLOCKS = 8
FEWEST = 4 * BLOCKS
"""Readings in a stretch."""

MOST_WANDER = 1 / 3
"""Standard deviation of block means beyond chance, over that of the noise: as of a straight drift by 1.1 sigma."""

MOST_UNEVEN = 4.0
"""Power of one block over that of the others."""

MOST_READINGS = 1 << 24
"""In a stretch, which is held in memory."""

_CHANCE = 1e-3  # that noise alone looks as unquiet


class Zero(NamedTuple):
    """What a sensor reads without load.

    Attributes
    ----------
    value : float
        Mean of the readings, in their unit.
    std : float
        Its standard uncertainty: of the mean of white noise and, where the readings wander more than that explains,
        of their wander in full, since it may go on; NaN of readings that do not vary.
    readings : int
        That it is the mean of.
    """

    value: float
    std: float
    readings: int


class Tare(NamedTuple):
    """A zero that was taken: when, what was read, and how warm it was.

    Attributes
    ----------
    start_s, stop_s : float
        The stretch, in seconds after the first row.
    reading, reading_std : float, float or None
        The zero and its standard uncertainty, in raw_unit; None where the readings did not vary.
    raw_unit : str
        Of the readings.
    readings : int
        That it is the mean of.
    temperature_degc : float or None
        Mean temperature over the stretch, where it is known.
    """

    start_s: float
    stop_s: float
    reading: float
    reading_std: float | None
    raw_unit: str
    readings: int
    temperature_degc: float | None = None


def zero_of(stretch: Floats) -> Zero:
    """Take the zero from a quiet stretch.

    Parameters
    ----------
    stretch : (n,) float array
        Readings without load, in any unit; NaN is left out, and what no sensor gives, as inf.

    Raises
    ------
    SensorError
        If fewer than 32 readings came, if they drift or step by more than their noise, or if their noise changes.

    Notes
    -----
    Eight blocks are compared by analysis of variance: their means with the noise within them, and the power of the
    loudest with that of the others. Refused is what is both significant (one in a thousand) and large.
    """
    from scipy.special import fdtrc

    seen = stretch[np.abs(stretch) <= BEYOND_ANY_SENSOR]
    if len(seen) < FEWEST:
        raise SensorError(f"The stretch has {len(seen)} readings; a zero needs {FEWEST}. Give a longer one.")
    blocks = np.array_split(seen - seen[0], BLOCKS)  # told from the first one, so that an offset costs no digits
    sizes = np.array([len(block) for block in blocks])
    means, squares = np.array([block.mean() for block in blocks]), np.array([block.var() for block in blocks]) * sizes
    middle, left = float(means @ sizes) / len(seen), len(seen) - BLOCKS
    between, within = float((means - middle) ** 2 @ sizes) / (BLOCKS - 1), float(squares.sum()) / left
    value = float(seen[0] + middle)
    if not between + within > 0:
        return Zero(value, np.nan, len(seen))
    _refuse_bursts(squares, sizes)
    if within > 0 and fdtrc(BLOCKS - 1, left, between / within) >= _CHANCE:
        return Zero(value, float(np.sqrt(np.var(seen, ddof=1) / len(seen))), len(seen))
    wander = float(np.sqrt((between - within) / sizes.mean()))
    if not wander <= MOST_WANDER * np.sqrt(within):
        raise SensorError(
            f"The stretch is not quiet: it wanders by {wander:.3g}, its noise is {np.sqrt(within):.3g}. Give a stretch "
            "in which the load does not change and the sensor is warm, or a longer one if its noise is slow."
        )
    return Zero(value, float(np.hypot(wander, np.sqrt(within / len(seen)))), len(seen))


def _refuse_bursts(squares: Floats, sizes: Floats) -> None:
    """Refuse a stretch of which one block is much louder than the others.

    Parameters
    ----------
    squares : (8,) float array
        Sums of squares about the mean of each block.
    sizes : (8,) int array
        Readings in each.
    """
    from scipy.special import fdtrc

    loudest = int(np.argmax(squares / sizes))
    free, others = float(sizes[loudest] - 1), float(sizes.sum() - sizes[loudest] - (BLOCKS - 1))
    loud, calm = squares[loudest] / free, (squares.sum() - squares[loudest]) / others
    if loud > MOST_UNEVEN * calm and (calm == 0 or BLOCKS * fdtrc(free, others, loud / calm) < _CHANCE):
        raise SensorError(
            f"The stretch is not quiet: in one of its eighths readings vary by {np.sqrt(loud):.3g}, in the others by "
            f"{np.sqrt(calm):.3g}. Give a stretch without knocks and spikes."
        )
