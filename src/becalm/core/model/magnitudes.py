"""Limits of magnitude beyond which a value is not a reading: from a record, from the noise, and from float64."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.verdict import BEYOND_ANY_SENSOR

_FACTOR = 1e9  # times the spread of nine in ten readings: more than any converter spans, about 30 bits
_QUANTILE = 0.9
_ROUNDING = 1e3  # times the noise: a reading that float64 rounds more coarsely is not one of this sensor


def find_largest(z: Floats) -> float:
    """Return the magnitude beyond which a value of a record is not a reading; 1e100 if all values may be readings.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit; NaN where missing. At most one in ten may be invalid.

    Notes
    -----
    The limit finds values that mean "none", such as 1e30 in a file, and broken digits. Gates reject spikes.
    """
    usable = z[np.abs(z) <= BEYOND_ANY_SENSOR]
    distances = np.abs(usable - np.median(usable)) if len(usable) else usable
    distances = distances[distances > 0]
    if not len(distances):
        return BEYOND_ANY_SENSOR
    spread = float(np.quantile(distances, _QUANTILE))
    largest = abs(float(np.median(usable))) + _FACTOR * spread
    return largest if np.abs(usable).max() > largest else BEYOND_ANY_SENSOR


def largest_magnitude_for_noise(noise_variance: float) -> float:
    """Return the magnitude beyond which float64 rounds a value more coarsely than the noise of the sensor.

    A filter that used such a reading could not recover: later corrections would be lost in the rounding of its
    state. Without noise the limit is 1e100.

    Parameters
    ----------
    noise_variance : float
        R, in unit^2; with a *small* one the limit is lower.
    """
    if not noise_variance > 0:
        return BEYOND_ANY_SENSOR
    return min(_ROUNDING * float(np.sqrt(noise_variance)) / float(np.finfo(float).eps), BEYOND_ANY_SENSOR)


def largest_level(noise_variance: float) -> float:
    """Return the largest level that can be subtracted from readings of this noise, in unit^2, without rounding them."""
    return largest_magnitude_for_noise(noise_variance) / _ROUNDING


def level_from_first_reading(reading: float, noise_variance: float) -> float:
    """Return the first reading as the level to subtract from all others; 0 if the rounding would hide their noise."""
    return reading if abs(reading) <= largest_level(noise_variance) else 0.0
