"""Compute the zero of a sensor from a stretch of readings without load, after a check that the stretch is quiet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import BEYOND_ANY_SENSOR
from becalm.errors import SensorError

BLOCKS = 8  # number of blocks into which a stretch is cut
FEWEST = 4 * BLOCKS
"""Least number of readings in a stretch."""

MOST_WANDER = 1 / 3
"""Largest standard deviation of the block means, beyond chance, over that of the noise: a linear drift of 1.1 sigma."""

MOST_UNEVEN = 4.0
"""Largest power of one block over that of the others."""

MOST_READINGS = 1 << 24
"""Largest number of readings in a stretch, which is kept in memory."""

_CHANCE = 1e-3  # probability that noise alone fails a test


class Zero(NamedTuple):
    """The reading of a sensor without load.

    Attributes
    ----------
    value : float
        Mean of the readings, in their unit.
    std : float
        Standard uncertainty of the value: that of a mean of white noise. If the block means vary more than white noise
        explains, the whole drift is added, because the drift may continue. NaN if all readings are equal.
    readings : int
        Number of readings in the mean.
    """

    value: float
    std: float
    readings: int


class Tare(NamedTuple):
    """A measured zero: the stretch, the value and the temperature.

    Attributes
    ----------
    start_s, stop_s : float
        Start and end of the stretch, in seconds after the first row.
    reading, reading_std : float, float or None
        The zero and its standard uncertainty, in raw_unit; the uncertainty is None if all readings are equal.
    raw_unit : str
        Unit of the readings.
    readings : int
        Number of readings in the mean.
    temperature_degc : float or None
        Mean temperature over the stretch; None if unknown.
    """

    start_s: float
    stop_s: float
    reading: float
    reading_std: float | None
    raw_unit: str
    readings: int
    temperature_degc: float | None = None


def zero_of(stretch: Floats) -> Zero:
    """Return the zero from a quiet stretch.

    Parameters
    ----------
    stretch : (n,) float array
        Readings without load, in any unit; NaN, inf and magnitudes above 1e100 are ignored.

    Raises
    ------
    SensorError
        If there are fewer than 32 readings, they drift or step by too much compared with their noise, or their noise
        changes.

    Notes
    -----
    Eight blocks are compared by analysis of variance: the variance of their means with the noise within them, and the
    largest power of a block with the power of the others. An error is raised if a difference is large and significant,
    with a probability by chance of less than one in a thousand.
    """
    from scipy.special import fdtrc

    usable = stretch[np.abs(stretch) <= BEYOND_ANY_SENSOR]
    if len(usable) < FEWEST:
        raise SensorError(f"The stretch has {len(usable)} readings; a zero needs {FEWEST}. Give a longer one.")
    blocks = np.array_split(usable - usable[0], BLOCKS)  # relative to the first, so that an offset costs no digits
    sizes = np.array([len(block) for block in blocks])
    means, squares = np.array([block.mean() for block in blocks]), np.array([block.var() for block in blocks]) * sizes
    middle, free = float(means @ sizes) / len(usable), len(usable) - BLOCKS
    between, within = float((means - middle) ** 2 @ sizes) / (BLOCKS - 1), float(squares.sum()) / free
    value = float(usable[0] + middle)
    if not between + within > 0:
        return Zero(value, np.nan, len(usable))
    _refuse_bursts(squares, sizes)
    if within > 0 and fdtrc(BLOCKS - 1, free, between / within) >= _CHANCE:
        return Zero(value, float(np.sqrt(np.var(usable, ddof=1) / len(usable))), len(usable))
    drift = float(np.sqrt((between - within) / sizes.mean()))
    if not drift <= MOST_WANDER * np.sqrt(within):
        raise SensorError(
            f"The stretch is not quiet: it drifts by {drift:.3g}, its noise is {np.sqrt(within):.3g}. Give a stretch "
            "in which the load does not change and the sensor is warm, or a longer one if its noise is slow."
        )
    return Zero(value, float(np.hypot(drift, np.sqrt(within / len(usable)))), len(usable))


def _refuse_bursts(squares: Floats, sizes: Floats) -> None:
    """Raise an error if one block of a stretch has much more power than the others.

    Parameters
    ----------
    squares : (8,) float array
        Sums of squares about the mean of each block.
    sizes : (8,) int array
        Number of readings in each block.
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
