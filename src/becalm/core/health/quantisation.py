"""Estimate the rounding error of a converter that remains after averaging.

`limits.find_resolution` finds the converter's step. Source: Widrow and Kollar, Quantization Noise (2008), chapters 4
and 9. Let readings of x have Gaussian noise of standard deviation s, and be rounded to steps of h. The mean of many
readings has the error

    sum over k of (-1)^k h / (pi k) sin(2 pi k x / h) exp(-2 pi^2 k^2 s^2 / h^2)

`residual_std` is the root mean square of this error over x: h / sqrt(12) for s = 0, and almost 0 for s = h / 2.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.health.limits import find_resolution

_TERMS = np.arange(1.0, 4097.0)  # k in the sum above
_MOST_REST = 0.5  # largest share of readings that equal the previous one, if the values were measured
_SET_CODES = 1.5  # codes: in set values, a quarter of the steps other than 0 are larger than this
_OF_NOISE = 0.455  # square of the median distance between two readings with a variance of 1/2 each


def converter_step(z: Floats) -> float:
    """Return the converter's step of finite readings (N,), in unit; 0 if they show none.

    Values that stay constant and then change by several codes were set by a program, not rounded by a converter.
    """
    step = find_resolution(z)
    if not step > 0:
        return 0.0
    steps = np.abs(np.diff(z))
    moves = steps[steps > 0]
    is_set = len(moves) < _MOST_REST * len(steps) and float(np.quantile(moves, 0.75)) > _SET_CODES * step
    return 0.0 if is_set else step


def residual_std(step: float, noise_std: float) -> float:
    """Return the standard deviation of the rounding error that averaging does not reduce, in unit.

    Parameters
    ----------
    step : float
        The converter's step, in unit.
    noise_std : float
        Standard deviation, before rounding, of the noise and motion that spread readings over the steps, in unit.
    """
    if not step > 0:
        return 0.0
    terms = np.exp(-((2 * np.pi * noise_std / step * _TERMS) ** 2)) / _TERMS**2
    return float(step / (np.pi * np.sqrt(2)) * np.sqrt(terms.sum()))


def rounding_left(z: Floats, noise_variance: float, averaged: int) -> float:
    """Return the standard deviation of the rounding error that a filter leaves in the signal, in unit.

    Parameters
    ----------
    z : (N,) float array
        Finite readings, in unit, in order.
    noise_variance : float
        R, in unit^2, rounding included.
    averaged : int
        Approximate number of readings that the filter averages. The motion of the signal during this time also spreads
        readings over codes.
    """
    step = converter_step(z)
    if not step > 0:
        return 0.0
    before_rounding = max(noise_variance - step**2 / 12, 0.0)
    apart = z[averaged:] - z[:-averaged]
    moved = float(np.median(np.abs(apart))) ** 2 if len(apart) else 0.0
    moved = max(moved - 2 * _OF_NOISE * noise_variance, 0.0)
    return residual_std(step, float(np.sqrt(before_rounding + moved / 12)))
