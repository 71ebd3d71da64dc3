"""Which magnitudes are readings at all: by a record, by a filter's noise, and by float64."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.verdict import BEYOND_ANY_SENSOR

_BEYOND = 1e9  # times what nine of ten readings keep to: more than any converter spans, and 30 bits
_MOST = 0.9
_ROUNDED = 1e3  # of a noise, to which a reading is rounded that cannot be one of a sensor so quiet


def find_largest(z: Floats) -> float:
    """Return the magnitude beyond which a value of a record is no reading; 1e100 where all of them may be.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit; NaN where missing. At most one in ten may be absurd.

    Notes
    -----
    A value for "none", as 1e30 in a file, or a broken digit. What only is large, a spike, is the business of gates.
    """
    seen = z[np.abs(z) <= BEYOND_ANY_SENSOR]
    apart = np.abs(seen - np.median(seen)) if len(seen) else seen
    apart = apart[apart > 0]
    if not len(apart):
        return BEYOND_ANY_SENSOR
    usual = float(np.quantile(apart, _MOST))
    largest = abs(float(np.median(seen))) + _BEYOND * usual
    return largest if np.abs(seen).max() > largest else BEYOND_ANY_SENSOR


def largest_beside(noise_variance: float) -> float:
    """Return the magnitude beyond which a reading is none of a sensor of this noise: float64 would round it away.

    A filter that believed it could not find back, for what it would have to add to its state has fewer digits
    than are lost. Without noise it is 1e100.

    Parameters
    ----------
    noise_variance : float
        R, in unit^2; with a *small* one fewer magnitudes are believed.
    """
    if not noise_variance > 0:
        return BEYOND_ANY_SENSOR
    return min(_ROUNDED * float(np.sqrt(noise_variance)) / float(np.finfo(float).eps), BEYOND_ANY_SENSOR)


def largest_level(noise_variance: float) -> float:
    """Return the largest level that readings of this noise, in unit^2, can be told from without being rounded."""
    return largest_beside(noise_variance) / _ROUNDED


def level_by(reading: float, noise_variance: float) -> float:
    """Return a first reading as the level that all others are told from; 0 where it would round their noise away."""
    return reading if abs(reading) <= largest_level(noise_variance) else 0.0
