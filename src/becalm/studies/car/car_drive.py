"""Simulate the drive of the car paper (Sensors 2001), with the voltages of its accelerometers and the true signal.

Rate, calibration, bands and signal-to-noise ratios are the paper's; its recordings are not public. The paper prints
neither the manoeuvres nor the noise of the speedometer nor the shares of the kinds of noise; these are chosen here.
Body motion counts as signal; vibrations of wheels and masses count as disturbances.
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
TRANSVERSE = (0.0067, 0.0078)  # sensitivity to the other acceleration, as a share of the sensor's own
RANGE_G = 2.0  # range of the sensors on each side of 0
INPUT_SNR_PAPER_DB = (-17.9, -1.6)  # along, up; 20 log10 of a ratio of powers
OUTPUT_SNR_PAPER_DB = (17.0, 39.0)  # along, up; in the same decibels
KMH = 3.6  # km/h in 1 m/s

SHARES = {"white": 0.7, "coloured": 0.2, "disturbances": 0.1}
"""Shares of the power of an accelerometer's noise; the paper names the kinds, but not their shares."""

OTHER_SHARES = (
    {"white": 0.98, "coloured": 0.01, "disturbances": 0.01},
    {"white": 0.4, "coloured": 0.2, "disturbances": 0.4},
    {"white": 0.3, "coloured": 0.6, "disturbances": 0.1},
)
"""Shares for drives with more white noise, with more disturbances, and with more coloured noise."""

COLOURED_HZ = (40.0, 80.0)  # band of the coloured noise
SPEED_NOISE_MPS = 0.3 / KMH

BODY_HZ, _WHEELS_HZ, _MASSES_HZ = VEHICLE_BANDS_HZ.values()
_KNOTS_S = (0, 4, 4.5, 9, 9.3, 9.7, 10, 16, 16.3, 16.7, 17, 26, 27, 34, 35, 40, 41, 45, 45.5, 52, 53, 60)
_KNOT_ACCELERATIONS_MPS2 = (0, 0, 2.8, 2.4, 0, 0, 2, 1.6, 0, 0, 1.2, 0.8, 0, 0, -1, -1, 0, 0, -3, -2.8, 0, 0)
_PITCH_MPS2, _HEAVE_MPS2 = 0.2, 1.0  # standard deviations of the body's acceleration along and up


class CarDrive(NamedTuple):
    """The readings and the true signal of a drive; N rows, accelerations along and up."""

    volts: Floats  # (N, 2) accelerometer voltages minus those at rest
    speed_kmh: Floats  # (N,) logged speed
    truth: Recording  # speed, acceleration along and up
    noise: dict[str, Floats]  # (N, 2) noise of each kind at the sensor, in m/s^2
    beyond_range: int  # number of readings that were clipped at the ends of the sensor's range

    @property
    def measured(self) -> Recording:
        """Return speed and accelerations in SI units, with the calibration of each sensor."""
        accelerations = self.volts * GRAVITY_MPS2 / SENSITIVITY_V_PER_G
        return _recording(np.column_stack([self.speed_kmh / KMH, accelerations]))


def simulate(seed: int = 1, shares: Mapping[str, float] = SHARES) -> CarDrive:
    """Simulate a drive of one minute: accelerate through three gears, cruise, slow down, brake.

    Parameters
    ----------
    seed : int
        Seed of the body's motion and of the noise.
    shares : mapping of str to float
        Shares of the power of an accelerometer's noise, by kind.
    """
    rng = np.random.default_rng(seed)
    count = round(DURATION_S * RATE_HZ)
    along = np.interp(np.arange(count) / RATE_HZ, _KNOTS_S, _KNOT_ACCELERATIONS_MPS2)
    speed = np.cumsum(along) / RATE_HZ
    moving = np.clip(speed / 5, 0.0, 1.0)
    along = along + moving * band_noise(rng, *BODY_HZ, count, _PITCH_MPS2)
    up = moving * band_noise(rng, *BODY_HZ, count, _HEAVE_MPS2)
    truth = np.column_stack([np.cumsum(along) / RATE_HZ, along, up])
    noise = _noise(rng, truth[:, 1:], shares)
    sensed = truth[:, 1:] + truth[:, :0:-1] * TRANSVERSE + sum(noise.values())
    clipped_g = np.clip(sensed / GRAVITY_MPS2, -RANGE_G, RANGE_G)
    speed_kmh = KMH * (truth[:, 0] + SPEED_NOISE_MPS * rng.normal(size=count))
    beyond = int(np.count_nonzero(np.abs(sensed) > RANGE_G * GRAVITY_MPS2))
    return CarDrive(clipped_g * SENSITIVITY_V_PER_G, speed_kmh, _recording(truth), noise, beyond)


def _noise(rng: np.random.Generator, signal: Floats, shares: Mapping[str, float]) -> dict[str, Floats]:
    """Return noise of each kind, (N, 2), scaled to the input signal-to-noise ratios that the paper prints."""
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
    """Return the vibration of wheels and masses in equal parts, (N,)."""
    return band_noise(rng, *_WHEELS_HZ, count, 1.0) + band_noise(rng, *_MASSES_HZ, count, 1.0)


def _recording(samples: Floats) -> Recording:
    return Recording(samples, names=NAMES, units=UNITS, rate_hz=RATE_HZ)
