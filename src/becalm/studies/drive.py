"""Simulate a test drive: speed, longitudinal and vertical acceleration of a car, with the true signal.

Rate and bands follow the car paper (Sensors 2001): 500 Hz, body motion at 1 to 3 Hz, wheels at 4 to 8 Hz. The
measurement noise is white.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfilt

from becalm.core.arrays import Floats
from becalm.core.recording import Recording

RATE_HZ = 500.0
DURATION_S = 60.0
NOISE_STD = (0.15, 0.8, 0.6)  # standard deviations of the noise of the sensors in `NAMES`; m/s, m/s^2, m/s^2
NAMES = ("speed (m/s)", "acceleration_x (m/s^2)", "acceleration_z (m/s^2)")
UNITS = ("m/s", "m/s^2", "m/s^2")


class Drive(NamedTuple):
    """The readings and the true signal of a drive."""

    measured: Recording
    truth: Recording


def simulate(seed: int = 1) -> Drive:
    """Simulate one minute on a rough road: accelerate, cruise, brake, accelerate again, brake hard."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(DURATION_S * RATE_HZ)) / RATE_HZ
    knots_s = [0, 3, 4, 12, 13, 25, 25.5, 30, 30.5, 36, 37, 44, 45, 50, 50.2, 54, 54.3, 60]
    accelerations = [0, 0, 2.2, 1.2, 0, 0, -3, -3, 0, 0, 2.5, 1, 0, 0, -6.5, -6.5, 0, 0]
    along = np.interp(t, knots_s, accelerations) + band_noise(rng, 1.0, 3.0, len(t), 0.12)
    speed = np.cumsum(along) / RATE_HZ + 2.0
    moving = np.clip(speed / 10, 0.2, 1.5)
    up = moving * (band_noise(rng, 1.0, 3.0, len(t), 0.5) + band_noise(rng, 4.0, 8.0, len(t), 0.4))
    truth = np.column_stack([speed, along, up])
    measured = truth + rng.normal(size=truth.shape) * NOISE_STD
    return Drive(_recording(measured), _recording(truth))


def band_noise(rng: np.random.Generator, low_hz: float, high_hz: float, count: int, std: float) -> Floats:
    """Return Gaussian noise in a frequency band at `RATE_HZ`, (count,), with standard deviation `std`."""
    sos = butter(2, [low_hz, high_hz], "bandpass", fs=RATE_HZ, output="sos")
    noise: Floats = sosfilt(sos, rng.normal(size=count))
    noise *= std / noise.std()
    return noise


def _recording(samples: Floats) -> Recording:
    return Recording(samples, names=NAMES, units=UNITS, rate_hz=RATE_HZ)
