"""What a converter's step leaves in readings: a noise that averaging lowers, and an error that it does not.

Source: Widrow and Kollar, Quantization Noise (2008), chapters 4 and 9. The mean of many readings of x with a Gaussian
noise of standard deviation s errs, by a step h, by

    sum over k of (-1)^k h / (pi k) sin(2 pi k x / h) exp(-2 pi^2 k^2 s^2 / h^2)

of which `residual_std` is the root of the mean square over x: h / sqrt(12) without noise, and next to nothing for a
noise of half a step.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.health.limits import find_resolution

_TERMS = np.arange(1.0, 4097.0)
_MOST_REST, _SET_CODES = (
    0.5,
    1.5,
)  # share of readings as the one before; codes that one in four other steps has, of set values
_OF_NOISE = 0.455  # square of the median of the distance of two readings of variance 1/2 each


def converter_step(z: Floats) -> float:
    """Return the step of the converter that finite readings (N,) come from, in unit; 0 where none is seen.

    Values that rest and then change by several codes are set, and not rounded.
    """
    step = find_resolution(z)
    if not step > 0:
        return 0.0
    steps = np.abs(np.diff(z))
    moves = steps[steps > 0]
    is_set = len(moves) < _MOST_REST * len(steps) and float(np.quantile(moves, 0.75)) > _SET_CODES * step
    return 0.0 if is_set else step


def residual_std(step: float, noise_std: float) -> float:
    """Return what of a converter's rounding no averaging lowers, in unit.

    Parameters
    ----------
    step : float
        Of the converter, in unit.
    noise_std : float
        Standard deviation, before rounding, of what moves the readings over the steps, in unit.
    """
    if not step > 0:
        return 0.0
    terms = np.exp(-((2 * np.pi * noise_std / step * _TERMS) ** 2)) / _TERMS**2
    return float(step / (np.pi * np.sqrt(2)) * np.sqrt(terms.sum()))


def rounding_left(z: Floats, noise_variance: float, averaged: int) -> float:
    """Return what of its converter's rounding a filter leaves in a signal, in unit.

    Parameters
    ----------
    z : (N,) float array
        Finite readings, in unit, in order.
    noise_variance : float
        R, in unit^2, with rounding in it.
    averaged : int
        Readings over which the filter averages about: what the signal mostly moves meanwhile spreads it over codes.
    """
    step = converter_step(z)
    if not step > 0:
        return 0.0
    before_rounding = max(noise_variance - step**2 / 12, 0.0)
    apart = z[averaged:] - z[:-averaged]
    moved = float(np.median(np.abs(apart))) ** 2 if len(apart) else 0.0
    moved = max(moved - 2 * _OF_NOISE * noise_variance, 0.0)
    return residual_std(step, float(np.sqrt(before_rounding + moved / 12)))
