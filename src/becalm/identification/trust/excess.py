"""Estimate how much smaller a smoother's error could be, from the colour of its innovations.

The ratio of the innovations' spectrum to a white one is the ratio of the readings' spectrum to that of the model. With
the model's noise, the readings show the signal at each frequency, and so the error of this smoother and of the best one
for such readings (Wiener 1949). Predictable innovations cost nothing at frequencies where the smoother passes nothing
or everything.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import autoregressive_power
from becalm.identification.likelihood import Tuning
from becalm.identification.spectrum import line_power

_ANGLES = np.pi * np.concatenate([np.geomspace(1e-7, 1e-2, 1500)[:-1], np.linspace(1e-2, 1.0, 3000)])

Colour = Callable[[Floats], Floats]
"""Function of angles (k,), radians per step, that returns the power (k,) of normalised innovations.

The power is 1 for a correct model.
"""


def excess_error(tuning: Tuning, colour: Colour) -> float:
    """Return the share by which a smoother's RMS error exceeds that of the best smoother for such readings.

    Parameters
    ----------
    tuning : Tuning
        The smoother's model.
    colour : callable
        The power of its normalised innovations over frequency.
    """
    signal, noise = powers(tuning, _ANGLES)
    passed = signal / (signal + noise)
    total = colour(_ANGLES) * (signal + noise)
    still_noise = np.minimum(noise, total)
    moved = total - still_noise
    own = (1 - passed) ** 2 * moved + passed**2 * still_noise
    best = _mean(moved * (still_noise / total))
    return float(np.sqrt(_mean(own) / best)) - 1 if best > 0 else 0.0


def powers(tuning: Tuning, angle: Floats) -> tuple[Floats, Floats]:
    """Return the power (k,) of the signal and of the noise in readings, unit^2, at angles (k,) in radians a step."""
    signal = tuning.motion_power(angle)
    noise = np.full_like(angle, tuning.noise_variance)
    for line in tuning.lines:
        power = line_power(line, angle)
        signal, noise = (signal, noise + power) if line.disturbance else (signal + power, noise)
    if tuning.coloured is not None:
        coefficients, innovation_variance = tuning.coloured.coefficients, tuning.coloured.innovation_variance
        noise = noise + autoregressive_power(coefficients, innovation_variance, angle)
    return signal, noise


def _mean(power: Floats) -> float:
    """Return the mean over all frequencies; below the lowest angle the power is constant."""
    return float((power[0] * _ANGLES[0] + np.trapezoid(power, _ANGLES)) / np.pi)
