"""Make motionless records of an accelerometer and a gyroscope from table 1 of the IMU paper, and find real rests.

The paper (Kownacki 2010) takes the variance after a 1 Hz high-pass for R and that after a 1 Hz low-pass for Q. Its
records are not public, but R and Q together show how the noise of each sensor was distributed over frequency. White
noise has a known share of its variance below 1 Hz. The accelerometer's noise has a smaller share there: a part of it is
white, and the other part is in the harmonics that the paper shows. The gyroscope's noise has a larger share there: it
contains white noise and a drift.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import butterworth_noise_gain
from becalm.core.recording import Recording
from becalm.identification.at_rest.detection import detect_rests
from becalm.identification.several.step_spectrum import Sensor

RATE_HZ = 1e4
SENSORS: tuple[Sensor, ...] = ("accelerometer", "gyroscope")
HARMONICS_HZ = np.arange(50.0, 501.0, 50.0)
RECORDS = range(10)  # seeds of the simulated records for table 1
RECORD_S = 120.0
"""Duration of the simulated records for table 1; other records last 10 s."""

SPLIT_HZ = 1.0  # cutoff of the paper's high-pass and low-pass
SPLIT_ORDER = 2
"""Order of both Butterworth filters; the paper prints their cutoff, but not their order."""

DRIFT_HZ = 0.1
"""Corner frequency of the simulated drift."""

_SETTLED_S = 2.0  # time in which both filters settle
_INDEPENDENT_HZ = 1.48 * SPLIT_HZ  # (int |H|^2 df)^2 / int |H|^4 df of the low-pass, over f from 0 to inf


class Printed(NamedTuple):
    """Tables 1 and 2 of the paper: R and Q, measured at rest and tuned, in unit^2."""

    measured_noise: float
    measured_process: float
    tuned_noise: float
    tuned_process: float

    @property
    def ratio(self) -> float:
        """Return Q/R of table 2."""
        return self.tuned_process / self.tuned_noise


PRINTED: dict[Sensor, Printed] = {
    "accelerometer": Printed(1.8472e-4, 1.1859e-8, 5.8631e-13, 1.3458e-11),
    "gyroscope": Printed(1.3872e-6, 2.4907e-9, 1.9148e-10, 1.9674e-7),
}


class NoiseParts(NamedTuple):
    """The parts of a motionless record, as variances in unit^2."""

    white: float
    harmonic: float
    drift: float


class Identified(NamedTuple):
    """R and Q of a motionless record by the paper's method, and the Q of white noise with the same R, in unit^2."""

    noise_variance: float
    process_variance: float
    white_process: float


class Rest(NamedTuple):
    """A rest in a real recording: its source, start and end, and R and Q of each channel by the paper's method."""

    source: str
    start_s: float
    stop_s: float
    rate_hz: float
    found: Mapping[str, Identified]

    @property
    def chance(self) -> float:
        """Return the relative standard deviation of Q that chance causes if all noise is white."""
        return float(1 / np.sqrt(_INDEPENDENT_HZ * (self.stop_s - self.start_s - _SETTLED_S)))


def noise_parts(printed: Printed) -> NoiseParts:
    """Return the parts of a record for which the paper's method gives its R and Q of table 1."""
    kept = butterworth_noise_gain(SPLIT_ORDER, SPLIT_HZ / RATE_HZ)
    white = min(printed.measured_noise, printed.measured_process / kept)
    passes = 2 / np.pi * np.arctan(SPLIT_HZ / DRIFT_HZ)  # share of the drift that passes the low-pass, approximately
    drift = max(0.0, printed.measured_process - kept * white) / passes
    return NoiseParts(white, printed.measured_noise - white, drift)


def white(sensor: Sensor, seed: int, duration_s: float = 10.0) -> Floats:
    """Return white noise (N,) with the variance R of table 1."""
    std = np.sqrt(PRINTED[sensor].measured_noise)
    return np.random.default_rng(seed).normal(0.0, std, round(duration_s * RATE_HZ))


def motionless(sensor: Sensor, seed: int, duration_s: float = 10.0) -> Floats:
    """Return a simulated motionless record (N,): white noise, equal harmonics of 50 to 500 Hz, and drift."""
    parts, rng = noise_parts(PRINTED[sensor]), np.random.default_rng([seed, SENSORS.index(sensor)])
    count = round(duration_s * RATE_HZ)
    z = rng.normal(0.0, np.sqrt(parts.white), count)
    z += np.sqrt(parts.harmonic) * harmonics(count, rng)
    z += np.sqrt(parts.drift) * _drift(count, rng)
    return z


def harmonics(count: int, rng: np.random.Generator) -> Floats:
    """Return the sum (count,) of equal harmonics of 50 to 500 Hz, with random phases and a variance of 1."""
    period = round(RATE_HZ / HARMONICS_HZ[0])
    turns = np.outer(np.arange(period) / RATE_HZ, HARMONICS_HZ) + rng.uniform(size=len(HARMONICS_HZ))
    tones = np.sin(2 * np.pi * turns).sum(axis=1)
    return np.resize(np.sqrt(2 / len(HARMONICS_HZ)) * tones, count)


def _drift(count: int, rng: np.random.Generator) -> Floats:
    """Return first-order Gauss-Markov noise (count,) of variance 1, from its stationary start."""
    from scipy.signal import lfilter

    pole = np.exp(-2 * np.pi * DRIFT_HZ / RATE_HZ)
    drive = np.sqrt(1 - pole**2) * rng.normal(size=count)
    drive[0] = rng.normal()
    return np.asarray(lfilter([1.0], [1.0, -pole], drive))


def identify(z: Floats, rate_hz: float) -> Identified:
    """Return R and Q of a motionless record (N,) by the paper's method: variances after a 1 Hz high-pass and low-pass.

    The first two seconds, in which the filters settle, are left out.
    """
    from scipy.signal import butter, sosfilt

    centred, settled = z - z.mean(), round(_SETTLED_S * rate_hz)

    def variance(kind: Literal["highpass", "lowpass"]) -> float:
        sos = butter(SPLIT_ORDER, SPLIT_HZ, kind, fs=rate_hz, output="sos")
        return float(np.var(sosfilt(sos, centred)[settled:]))

    high, low = variance("highpass"), variance("lowpass")
    kept = butterworth_noise_gain(SPLIT_ORDER, SPLIT_HZ / rate_hz)
    return Identified(high, low, kept / (1 - kept) * high)


def find_rests(data: Path) -> tuple[tuple[Rest, ...], tuple[str, ...]]:
    """Return the longest rest of each sensor in real recordings, and a sentence for each recording left out."""
    rests, skipped = list[Rest](), list[str]()
    for source, reader in _READERS.items():
        path = data / source
        if not path.exists():
            skipped.append(f"{source} is absent, and is left out.")
            continue
        try:
            found = [_rest_of(source, recording) for recording in reader(path)]
        except ImportError as missing:
            skipped.append(f"{source} is left out: reading it needs {missing.name}, which is not installed.")
            continue
        rests += [rest for rest in found if rest is not None]
        skipped += [f"{source}: no rest was found in {found.count(None)} of its sensors."] if None in found else []
    return tuple(rests), tuple(skipped)


def _rest_of(source: str, recording: Recording) -> Rest | None:
    still = detect_rests(recording).stretches
    if not still:
        return None
    start, stop = max(still, key=lambda each: each.stop - each.start)
    rate = recording.rate_hz
    rows = slice(start, stop)
    found = {
        f"{name} ({unit})" if unit else name: identify(recording.channel(name)[rows], rate)
        for name, unit in zip(recording.names, recording.units, strict=True)
    }
    return Rest(source, start / rate, stop / rate, rate, found)


def _columns_of_text(path: Path) -> Iterator[Recording]:
    """Read time and three axes, in counts, from a text file."""
    table = np.loadtxt(path)
    kind = path.name.split("_")[1].split(".")[0]
    names = [f"{kind} {axis}" for axis in "xyz"]
    yield Recording(table[:, 1:], names=names, units=["counts"] * 3, times_s=table[:, 0])


def _mat(path: Path) -> Iterator[Recording]:
    from scipy.io import loadmat

    yield from _broad(loadmat(path))


def _hdf5(path: Path) -> Iterator[Recording]:
    import h5py

    with h5py.File(path) as file:
        arrays = {name: file[name][:] for name in ("imu_acc", "imu_gyr")}
        yield from _broad(arrays | {"sampling_rate": np.array(file.attrs["sampling_rate"])})


def _broad(arrays: Mapping[str, Any]) -> Iterator[Recording]:
    rate = float(arrays["sampling_rate"].item())
    for name, kind, unit in (("imu_acc", "acc", "m/s^2"), ("imu_gyr", "gyro", "rad/s")):
        yield Recording(arrays[name], names=[f"{kind} {axis}" for axis in "xyz"], units=[unit] * 3, rate_hz=rate)


_READERS = {
    "imu_tk/xsens_acc.mat.txt.gz": _columns_of_text,
    "imu_tk/xsens_gyro.mat.txt.gz": _columns_of_text,
    "broad/04_undisturbed_slow_rotation_with_breaks_A.mat": _mat,
    "broad/05_undisturbed_slow_rotation_with_breaks_B.hdf5": _hdf5,
}
