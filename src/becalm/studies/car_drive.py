"""A simulated drive of the car paper (Sensors 2001), from the volts of its accelerometers on, with its truth.

Rate, calibration, bands and signal-to-noise ratios are the paper's; its recordings are not public. What it does not
print is chosen here, and named: the manoeuvres, the noise of the speedometer, and the shares of the kinds of noise.
Body motion counts as signal, vibrations of wheels and masses as disturbances.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.metrics.spectrum import VEHICLE_BANDS_HZ
from becalm.studies.drive import NAMES, RATE_HZ, UNITS, band_noise

DURATION_S = 60.0
GRAVITY_MPS2 = 9.81
SENSITIVITY_V_PER_G = (0.9856, 1.0025)  # longitudinal, vertical
TRANSVERSE = (0.0067, 0.0078)
RANGE_G = 2.0
INPUT_SNR_PAPER_DB = (-17.9, -1.6)
OUTPUT_SNR_PAPER_DB = (17.0, 39.0)
KMH = 3.6

SHARES = {"white": 0.7, "coloured": 0.2, "disturbances": 0.1}
"""Of the power of an accelerometer's noise; the paper names the kinds, not how much of each."""

OTHER_SHARES = (
    {"white": 0.98, "coloured": 0.01, "disturbances": 0.01},
    {"white": 0.4, "coloured": 0.2, "disturbances": 0.4},
    {"white": 0.3, "coloured": 0.6, "disturbances": 0.1},
)
"""Drives with more white noise, more disturbances, and more coloured noise."""

COLOURED_HZ = (40.0, 80.0)
SPEED_NOISE_MPS = 0.3 / KMH

BODY_HZ, _WHEELS_HZ, _MASSES_HZ = VEHICLE_BANDS_HZ.values()
_KNOTS_S = (0, 4, 4.5, 9, 9.3, 9.7, 10, 16, 16.3, 16.7, 17, 26, 27, 34, 35, 40, 41, 45, 45.5, 52, 53, 60)
_PULLS_MPS2 = (0, 0, 2.8, 2.4, 0, 0, 2, 1.6, 0, 0, 1.2, 0.8, 0, 0, -1, -1, 0, 0, -3, -2.8, 0, 0)
_PITCH_MPS2, _HEAVE_MPS2 = 0.2, 1.0  # standard deviations of the body's motion, along and up


class CarDrive(NamedTuple):
    """What the sensors said, and what was true; N rows, the accelerometers along and up."""

    volts: Floats  # (N, 2) of the accelerometers, less their reading at rest
    speed_kmh: Floats  # (N,) logged
    truth: Recording  # speed, acceleration along and up
    noise: dict[str, Floats]  # of each kind (N, 2) m/s^2, at the sensor
    beyond_range: int  # readings that the sensor held at the end of its range

    @property
    def measured(self) -> Recording:
        """Speed and accelerations in SI units, by the calibration of each sensor."""
        accelerations = self.volts * GRAVITY_MPS2 / SENSITIVITY_V_PER_G
        return _recording(np.column_stack([self.speed_kmh / KMH, accelerations]))


def simulate(seed: int = 1, shares: Mapping[str, float] = SHARES) -> CarDrive:
    """Drive for a minute: pull away through three gears, cruise, slow down, brake.

    Parameters
    ----------
    seed : int
        Of road and noise.
    shares : mapping of str to float
        Of the power of an accelerometer's noise, by kind.
    """
    rng = np.random.default_rng(seed)
    count = round(DURATION_S * RATE_HZ)
    along = np.interp(np.arange(count) / RATE_HZ, _KNOTS_S, _PULLS_MPS2)
    speed = np.cumsum(along) / RATE_HZ
    moving = np.clip(speed / 5, 0.0, 1.0)
    along = along + moving * band_noise(rng, *BODY_HZ, count, _PITCH_MPS2)
    up = moving * band_noise(rng, *BODY_HZ, count, _HEAVE_MPS2)
    truth = np.column_stack([np.cumsum(along) / RATE_HZ, along, up])
    noise = _noise(rng, truth[:, 1:], shares)
    felt = truth[:, 1:] + truth[:, :0:-1] * TRANSVERSE + sum(noise.values())
    held = np.clip(felt / GRAVITY_MPS2, -RANGE_G, RANGE_G)
    speed_kmh = KMH * (truth[:, 0] + SPEED_NOISE_MPS * rng.normal(size=count))
    beyond = int(np.count_nonzero(np.abs(felt) > RANGE_G * GRAVITY_MPS2))
    return CarDrive(held * SENSITIVITY_V_PER_G, speed_kmh, _recording(truth), noise, beyond)


def _noise(rng: np.random.Generator, signal: Floats, shares: Mapping[str, float]) -> dict[str, Floats]:
    """Return noise of each kind, (N, 2), with the input signal-to-noise ratios that the paper prints."""
    shape = signal.shape
    power = np.mean(signal**2, axis=0) / 10 ** (np.array(INPUT_SNR_PAPER_DB) / 20)  # 20 log10 of a ratio of powers
    kinds = {
        "white": rng.normal(size=shape),
        "coloured": np.column_stack([band_noise(rng, *COLOURED_HZ, len(signal), 1.0) for _ in range(2)]),
        "disturbances": np.column_stack([_vibration(rng, len(signal)) for _ in range(2)]),
    }
    noise = {name: values * np.sqrt(shares[name] / np.mean(values**2, axis=0)) for name, values in kinds.items()}
    total = np.mean(sum(noise.values()) ** 2, axis=0)
    return {name: values * np.sqrt(power / total) for name, values in noise.items()}


def _vibration(rng: np.random.Generator, count: int) -> Floats:
    """Return wheels and masses in equal parts, (N,)."""
    return band_noise(rng, *_WHEELS_HZ, count, 1.0) + band_noise(rng, *_MASSES_HZ, count, 1.0)


def _recording(samples: Floats) -> Recording:
    return Recording(samples, names=NAMES, units=UNITS, rate_hz=RATE_HZ)
