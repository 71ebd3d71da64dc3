"""Faults of a sensor: found within the delay that is stated, and no alarm in hours of healthy readings.

Limits are found from the first minute (or from 30 000 readings) of each record, and the record is then watched as
it would come. Readings are in sigma of their white noise; LSB is the step of the converter.

Run: python benchmarks/sensor_faults.py [-o docs/sensor-faults.md] [--seeds N]
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import becalm
from becalm.core.faults import Faults, said
from becalm.core.limits import Limits, find_limits
from becalm.core.model import Model
from becalm.core.monitor import InnovationMonitor, find_alarms, said_of_noise
from becalm.core.verdict import Verdict
from pages import page_parser, publish

Floats = NDArray[np.float64]

RATES_HZ = (500, 10_000)
STEPS = (0.0, 0.2, 1.0, 3.0)
LEARNT = 30_000
ALARMS_PER_HOUR = 1.0
DATA = Path(__file__).parents[2] / "shared" / "data"
REAL = {
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


def learnt(z: Floats, elapsed: Floats, rate_hz: float) -> Limits:
    """Find the limits from the start of a record."""
    count = max(LEARNT, int(60 * rate_hz))
    return find_limits(z[:count], elapsed[:count], ALARMS_PER_HOUR, 1 / rate_hz)


def watched(z: Floats, elapsed: Floats, limits: Limits) -> Faults:
    """Push a record in blocks."""
    faults = Faults(limits)
    for start in range(0, len(z), 1 << 16):
        faults.push(z[start : start + (1 << 16)], elapsed[start : start + (1 << 16)])
    return faults


def false_alarms(rate_hz: int, lsb: float, seed: int) -> dict[str, int]:
    """Return how many readings of an hour of each healthy signal were called faulty."""
    out = {}
    for name in SIGNALS:
        z, elapsed = record(name, 3600 * rate_hz, rate_hz, lsb, seed)
        faults = watched(z, elapsed, learnt(z, elapsed, rate_hz))
        out[name] = sum(found.count for found in faults.found.values())
    return out
