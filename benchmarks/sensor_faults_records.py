"""Make healthy records: signals of many kinds in white noise of one sigma, rounded to the step of a converter.

The module also lists real recordings, which are in a folder next to the project.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RATES_HZ = (500, 10_000)
STEPS = (0.0, 0.2, 1.0, 3.0)
"""Steps of the converter in sigma; 0 means no rounding."""

LEARNT = 30_000
"""Number of readings from which limits are identified, a minute at 500 Hz."""

ALARMS_PER_HOUR = 1.0

DATA = Path(__file__).parents[2] / "shared" / "data"
REAL: dict[str, float | None] = {
    "comma2k19/accelerometer.csv": None,
    "comma2k19/gyroscope.csv": None,
    "comma2k19/can_speed.csv": None,
    "munich_bridge/reference_state_strain.csv.gz": None,
    "munich_bridge/support_load_strain.csv.gz": None,
    "fusion/sensor_data.csv": None,
    "gaitmap/imu_sample.csv": 204.8,
    "imu_tk/xsens_acc.mat.txt.gz": None,
    "imu_tk/xsens_gyro.mat.txt.gz": None,
}
"""Recordings of healthy sensors; the rate in Hz is for files with row numbers instead of times."""

Signal = Callable[[Floats, np.random.Generator], Floats]
"""Function that gets times (N,) in seconds and a random generator, and returns a signal (N,) in sigma of the noise."""


def _ramp_and_hold(t: Floats, _: np.random.Generator) -> Floats:
    phase = t % 20.0
    return np.asarray(50.0 * np.clip(np.minimum(phase - 4.0, 16.0 - phase), 0.0, 4.0))


SIGNALS: dict[str, Signal] = {
    "white": lambda t, _: np.zeros(len(t)),
    "random walk": lambda t, rng: np.cumsum(rng.normal(0.0, 0.3, len(t))),
    "sine": lambda t, _: 100 * np.sin(2 * np.pi * 0.1 * t),
    "vibration": lambda t, _: 100 * np.sin(2 * np.pi * 37.3 * t),
    "ramp and hold": _ramp_and_hold,
    "square wave": lambda t, _: 40 * np.sign(np.sin(2 * np.pi * 0.7 * t)),
}


def digitised(z: Floats, lsb: float) -> Floats:
    """Return readings (N,) rounded to the steps of a converter; without a converter, return them unchanged."""
    return np.round(z / lsb) * lsb if lsb else z


def record(name: str, count: int, rate_hz: float, lsb: float, seed: int) -> tuple[Floats, Floats]:
    """Return a healthy record: readings (N,) in sigma, with a random offset, and the steps before them."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) / rate_hz
    elapsed = np.ones(count)
    elapsed[0] = 0.0
    return digitised(rng.uniform(0, 5) + SIGNALS[name](t, rng) + rng.normal(size=count), lsb), elapsed
