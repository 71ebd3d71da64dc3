"""How much smaller a smoother's error could be, told from how its innovations are coloured.

The innovations' spectrum, beside a white one, is that of the readings beside the model's own. With
what the model takes for noise, readings tell what is signal at each frequency, and so the error of
this smoother, and of the best one for such readings (Wiener 1949). Innovations that are predictable
where the smoother listens to nothing, or believes everything, cost nothing.
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
"""Takes angles (k,), radians a step; returns the power (k,) of normalised innovations there, 1 where all is right."""


def excess_error(tuning: Tuning, colour: Colour) -> float:
    """Return by which share a smoother's rms error exceeds that of the best smoother for such readings.

    Parameters
    ----------
    tuning : Tuning
        The smoother's model.
    colour : callable
        The power of its normalised innovations over frequency.
    """
    signal, noise = powers(tuning, _ANGLES)
    passed = signal / (signal + noise)
    found = colour(_ANGLES) * (signal + noise)
    still_noise = np.minimum(noise, found)
    moved = found - still_noise
    own = (1 - passed) ** 2 * moved + passed**2 * still_noise
    best = _mean(moved * (still_noise / found))
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
    """Return the mean over all frequencies; what is slower than the slowest has its power."""
    return float((power[0] * _ANGLES[0] + np.trapezoid(power, _ANGLES)) / np.pi)
