"""Healthy records, by seed: signals of many kinds in white noise of one sigma, read by a converter of any step.

And the real ones, which lie beside the project.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RATES_HZ = (500, 10_000)
STEPS = (0.0, 0.2, 1.0, 3.0)
"""Of the converter, in sigma; 0 is none."""

LEARNT = 30_000
"""Readings that limits are found from: a minute at 500 Hz."""

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
"""Recordings of healthy sensors, and the rate, in Hz, of those that only count their rows."""

Signal = Callable[[Floats, np.random.Generator], Floats]
"""Takes times (N,), in seconds; returns a signal (N,), in sigma of the noise."""


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
    """Return readings (N,) rounded to the steps of a converter; as they are with none."""
    return np.round(z / lsb) * lsb if lsb else z


def record(name: str, count: int, rate_hz: float, lsb: float, seed: int) -> tuple[Floats, Floats]:
    """Return a healthy record: readings (N,), in sigma, at an offset of its own, and the steps before them."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) / rate_hz
    elapsed = np.ones(count)
    elapsed[0] = 0.0
    return digitised(rng.uniform(0, 5) + SIGNALS[name](t, rng) + rng.normal(size=count), lsb), elapsed
