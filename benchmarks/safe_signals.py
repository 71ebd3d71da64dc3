"""Make signals with known truth and known white noise, which `safe.py` damages.

Every signal has a standard deviation of 1 about a level of 5, so that a reading of 0 is wrong. The two real signals are
real records without their noise, which a low-pass filter without lag removes; then they get white noise like all
signals.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, sosfiltfilt

import becalm

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

RATE_HZ = 200.0
ROWS = 8000
LEVEL = 5.0
NOISE = 0.05
DATA = Path(__file__).parents[2] / "shared" / "data"


class Signal(NamedTuple):
    """A kind of signal.

    Attributes
    ----------
    make : callable
        Function that gets a number of rows and a random generator, and returns the truth (N,), at any level and scale.
    tails : float
        Degrees of freedom of the noise's Student t; inf for Gaussian noise.
    """

    make: Callable[[int, np.random.Generator], Floats]
    tails: float = np.inf


def walk(rows: int, rng: np.random.Generator) -> Floats:
    """Return a random walk."""
    return np.cumsum(rng.normal(size=rows))


def damped(rows: int, rng: np.random.Generator, order: int) -> Floats:
    """Return white noise integrated `order` times; each integrator leaks with a time constant of 2/order seconds."""
    pole = np.exp(-order / (2.0 * RATE_HZ))
    x = rng.normal(size=rows + 4000)
    for _ in range(order):
        x = lfilter([1.0], [1.0, -pole], x)
    return np.asarray(x[4000:])


def band(rows: int, rng: np.random.Generator, highest_hz: float) -> Floats:
    """Return Gaussian noise below a frequency, and nothing above it."""
    spectrum = np.fft.rfft(rng.normal(size=rows))
    frequencies = np.fft.rfftfreq(rows, 1 / RATE_HZ)
    spectrum[(frequencies > max(highest_hz, 2 * RATE_HZ / rows)) | (frequencies == 0)] = 0
    return np.fft.irfft(spectrum, rows)


def tones(rows: int, rng: np.random.Generator) -> Floats:
    """Return three sines of 3.1, 11.7 and 27 Hz."""
    t, phases = np.arange(rows) / RATE_HZ, rng.uniform(0, 2 * np.pi, 3)
    sizes = zip((1.0, 0.6, 0.3), (3.1, 11.7, 27.0), phases, strict=True)
    return np.asarray(sum(size * np.sin(2 * np.pi * hz * t + phase) for size, hz, phase in sizes))


def stairs(rows: int, rng: np.random.Generator) -> Floats:
    """Return at least two levels, which last 100 to 700 rows each."""
    lengths = rng.integers(100, min(700, rows // 2 + 1), rows // 100 + 1)
    return np.repeat(rng.normal(size=len(lengths)), lengths)[:rows]


def saw(rows: int, rng: np.random.Generator) -> Floats:
    """Return ramps of 300 rows, each with a fall at its end."""
    return np.asarray((np.arange(rows) + rng.integers(300)) % 300 / 300.0)


def impacts(rows: int, rng: np.random.Generator) -> Floats:
    """Return impacts about once a second; each rings at 12 Hz and decays with a time constant of 0.1 s."""
    blows = np.where(rng.uniform(size=rows) < 1 / RATE_HZ, rng.normal(size=rows), 0.0)
    blows[rows // 2] = 1.0  # without any impact the standard deviation would be 0
    t = np.arange(200) / RATE_HZ
    return np.convolve(blows, np.exp(-t / 0.1) * np.sin(2 * np.pi * 12 * t))[:rows]


def drift(rows: int, rng: np.random.Generator) -> Floats:
    """Return half a period of a sine over the record, and a ramp."""
    share = np.arange(rows) / rows
    return np.sin(np.pi * share + rng.uniform(0, np.pi)) + rng.uniform(-1, 1) * share


@cache
def _recorded(file: str, channel: int, highest_share: float) -> Floats | None:
    """Return a channel of a real record below a cut-off, as a share of half its rate; None if the record is absent."""
    if not (DATA / file).exists():
        return None
    samples = becalm.read(DATA / file).samples
    z = samples[np.isfinite(samples[:, channel]), channel]
    return np.asarray(sosfiltfilt(butter(4, highest_share, output="sos"), z))


def real_imu(rows: int, rng: np.random.Generator) -> Floats:
    """Return a car's acceleration below 10 Hz, from a random row on."""
    return _part_of(_recorded("comma2k19/accelerometer.csv", 0, 0.2), rows, rng)


def real_strain(rows: int, rng: np.random.Generator) -> Floats:
    """Return the strain of a bridge below 5 Hz, from a random row on."""
    return _part_of(_recorded("munich_bridge/support_load_strain.csv.gz", 0, 0.1), rows, rng)


def _part_of(record: Floats | None, rows: int, rng: np.random.Generator) -> Floats:
    """Return some rows of a record, or all if it is shorter; an empty array if it is absent."""
    if record is None:
        return np.empty(0)
    start = int(rng.integers(max(len(record) - rows, 0) + 1))
    return record[start : start + rows]


SIGNALS: dict[str, Signal] = {
    "walk": Signal(walk),
    "order 2": Signal(lambda rows, rng: damped(rows, rng, 2)),
    "order 3": Signal(lambda rows, rng: damped(rows, rng, 3)),
    "order 4": Signal(lambda rows, rng: damped(rows, rng, 4)),
    "band 2 Hz": Signal(lambda rows, rng: band(rows, rng, 2.0)),
    "band 30 Hz": Signal(lambda rows, rng: band(rows, rng, 30.0)),
    "tones": Signal(tones),
    "stairs": Signal(stairs),
    "saw": Signal(saw),
    "impacts": Signal(impacts),
    "heavy tails": Signal(lambda rows, rng: damped(rows, rng, 2), tails=3.0),
    "slow drift": Signal(drift),
    "real IMU": Signal(real_imu),
    "real strain": Signal(real_strain),
}
"""All kinds of signals by name."""


class Record(NamedTuple):
    """A record, its truth and its damage.

    Attributes
    ----------
    truth : (N,) float array
        True signal.
    sound : (N,) float array
        Readings of an undamaged sensor: truth and noise.
    readings : (N,) float array
        Readings of this sensor; NaN where missing.
    hidden : (N,) bool array
        Flags of rows whose reading does not depend on the truth in that row.
    touched : (N,) bool array
        Flags of all rows that an insult changes, hidden or not.
    noise_std : float
        Standard deviation of the white noise.
    resolution : float
        Step of the converter; 0 for none.
    every : int
        Number of rows from one new reading to the next.
    """

    truth: Floats
    sound: Floats
    readings: Floats
    hidden: Flags
    touched: Flags
    noise_std: float
    resolution: float = 0.0
    every: int = 1


def undamaged(signal: Signal, rng: np.random.Generator, rows: int = ROWS, noise: float = NOISE) -> Record | None:
    """Return a record of a signal with white noise, a share of its standard deviation; None if its file is absent."""
    made = signal.make(rows, rng)
    if not len(made):
        return None
    truth = LEVEL + (made - made.mean()) / made.std()
    drawn = rng.normal(size=len(truth)) if np.isinf(signal.tails) else rng.standard_t(signal.tails, len(truth))
    scale = 1.0 if np.isinf(signal.tails) else np.sqrt((signal.tails - 2) / signal.tails)
    sound = truth + noise * scale * drawn
    nowhere = np.zeros(len(truth), bool)
    return Record(truth, sound, sound, nowhere, nowhere, noise)
