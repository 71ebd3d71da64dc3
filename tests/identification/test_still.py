"""RestPeriods are found where they are, in any unit, and never where there are none."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from becalm.core.arrays import Booleans, Floats
from becalm.core.recording import Recording
from becalm.errors import RecordingError
from becalm.identification.at_rest.detection import RestPeriods, detect_rests, rests_in_spans

DATA = Path(__file__).parents[2].parent / "shared" / "data"
RATE_HZ = 100.0
COUNT = 12_000
T = np.arange(COUNT) / RATE_HZ
MOVES = ((10.0, 25.0), (40.0, 44.0), (60.0, 95.0))  # s


def moving() -> Booleans:
    return np.asarray(np.any([(begin <= T) & (end > T) for begin, end in MOVES], axis=0))


def record(seed: int = 0) -> Floats:
    """Two channels with unit noise on an offset, that wave about in the moves."""
    rng = np.random.default_rng(seed)
    waves = np.column_stack([np.sin(2 * np.pi * 1.3 * T), np.cos(2 * np.pi * 0.7 * T)])
    ramp = np.minimum.reduce([np.abs(T - edge) for move in MOVES for edge in move])  # starts and ends gently
    truth = np.where(moving(), np.minimum(30 * ramp, 20), 0)[:, np.newaxis] * waves
    return np.asarray(truth + np.array([0.0, 981.0]) + rng.normal(size=truth.shape))


def hits(found: RestPeriods, still: Booleans) -> tuple[float, float]:
    """Return precision and recall by samples."""
    mask = found.mask(len(still))
    return float(still[mask].mean()) if mask.any() else 0.0, float(mask[still].mean())


def spiked(z: Floats) -> Floats:
    z = z.copy()
    z[np.random.default_rng(1).random(z.shape) < 0.01] += 1000.0
    return z


def holed(z: Floats) -> Floats:
    return np.where(np.random.default_rng(2).random(z.shape) < 0.1, np.nan, z)


SEEN_AS: dict[str, Callable[[Floats], Floats]] = {
    "as it is": lambda z: z,
    "one channel": lambda z: z[:, 0],
    "quantised to a third of sigma": lambda z: np.round(z * 3) / 3,
    "quantised to sigma": np.round,
    "quantised to four sigma": lambda z: 4 * np.round((z - 981) / 4 + 0.4),
    "with spikes": spiked,
    "with readings missing": holed,
    "far from zero": lambda z: z + 1e7,
    "times a million": lambda z: 1e6 * z,
    "times a millionth": lambda z: 1e-6 * z,
    "upside down": lambda z: -z,
    "drifting": lambda z: z + 0.02 * T[:, np.newaxis],
    "beside a channel that is stuck": lambda z: np.column_stack([z, np.full(len(z), 3.0)]),
}


@pytest.mark.parametrize("name", SEEN_AS)
def test_rests_are_found_and_nothing_else(name: str) -> None:
    found = detect_rests(Recording(SEEN_AS[name](record()), rate_hz=RATE_HZ))
    precision, recall = hits(found, ~moving())
    assert precision > 0.99, found.reason
    assert recall > 0.9, found.reason
    assert len(found.stretches) == len(MOVES) + 1
    assert found.reason.startswith("4 rests")


@pytest.mark.parametrize("seed", range(5))
def test_a_record_at_rest_is_still_throughout(seed: int) -> None:
    z = np.random.default_rng(seed).normal(size=3000)
    found = detect_rests(Recording(z, rate_hz=RATE_HZ))
    assert found.mask(3000).mean() > 0.95
    assert "throughout" in found.reason


def test_rest_of_a_slow_sensor_at_a_high_rate_is_found() -> None:
    """Noise of 50 Hz, read at 10 kHz: coloured, and yet at rest."""
    from scipy.signal import lfilter

    pole = np.exp(-2 * np.pi * 50 / 1e4)
    z = lfilter([1 - pole], [1, -pole], np.random.default_rng(4).normal(size=100_000))
    z[40_000:60_000] += np.sin(np.arange(20_000) / 1e3)
    found = detect_rests(Recording(z, rate_hz=1e4))
    rest = np.ones(100_000, dtype=bool)
    rest[40_000:60_000] = False
    precision, recall = hits(found, rest)
    assert precision > 0.99
    assert recall > 0.9


RNG = np.random.default_rng(5)
NOISE = RNG.normal(size=COUNT)


def coloured(pole: float) -> Floats:
    from scipy.signal import lfilter

    return np.asarray(lfilter([1.0], [1.0, -pole], NOISE))


NEVER_STILL = {
    "slow sine": 5 * np.sin(2 * np.pi * 0.2 * T) + NOISE,
    "sine": np.sin(2 * np.pi * T) + 0.1 * NOISE,
    "sine without noise": np.sin(2 * np.pi * T),
    "steady hum": np.sin(2 * np.pi * 10 * T) + 0.1 * NOISE,
    "chirp": np.sin(2 * np.pi * 0.05 * T**2) + 0.1 * NOISE,
    "random walk": np.cumsum(NOISE),
    "ramp without noise": 0.3 * T,
    "steep ramp": 20 * T + 0.1 * NOISE,
    "band below one hertz": coloured(0.95),
    "noise that swells and fades": NOISE * np.exp(np.sin(2 * np.pi * T / 7)),
    "heavy tails": RNG.standard_t(1, size=COUNT),
    "stuck": np.full(COUNT, 4.2),
    "missing": np.full(COUNT, np.nan),
}


@pytest.mark.parametrize("name", NEVER_STILL)
def test_a_record_without_rest_says_so(name: str) -> None:
    found = detect_rests(Recording(NEVER_STILL[name], rate_hz=RATE_HZ))
    assert found.stretches == ()
    assert found.reason.endswith(".")


@pytest.mark.parametrize("count", [0, 1, 2, 31, 49, 99])
def test_a_short_record_says_so(count: int) -> None:
    found = detect_rests(Recording(NOISE[:count], rate_hz=RATE_HZ))
    assert found.stretches == ()


def test_a_gap_is_no_rest() -> None:
    times_s = np.concatenate([T[:3000], 60 + T[:3000]])
    found = detect_rests(Recording(NOISE[:6000], times_s=times_s))
    assert [stretch.start for stretch in found.stretches] == [0, pytest.approx(3000, abs=60)]
    assert found.stretches[0].stop <= 3000 <= found.stretches[1].start


def test_shorter_rests_are_found_when_asked_for() -> None:
    z = record()[:, 0]
    z[np.abs(T - 50) < 4] = record(7)[np.abs(T - 18) < 4, 0][: np.count_nonzero(np.abs(T - 50) < 4)]
    z[np.abs(T - 50) < 0.6] = NOISE[np.abs(T - 50) < 0.6]
    long, short = (detect_rests(Recording(z, rate_hz=RATE_HZ), shortest_s) for shortest_s in (1.0, 0.4))
    assert not long.mask(COUNT)[5000]
    assert short.mask(COUNT)[5000]


@pytest.mark.parametrize("shortest_s", [0.0, -1.0, np.nan, np.inf])
def test_a_rest_of_no_duration_is_refused(shortest_s: float) -> None:
    with pytest.raises(RecordingError, match="shortest_s"):
        detect_rests(Recording(NOISE, rate_hz=RATE_HZ), shortest_s)


def test_said_stretches_are_rows() -> None:
    recording = Recording(NOISE, times_s=1e6 + T)
    assert rests_in_spans(recording, [(0, 30)]).stretches == ((0, 3000),)
    assert rests_in_spans(recording, [(60, 70.5), (5, 10), (8, 12)]).stretches == ((500, 1200), (6000, 7050))
    assert rests_in_spans(recording, [(100, 1000)]).stretches == ((10_000, COUNT),)


@pytest.mark.parametrize(
    ("spans_s", "words"),
    [
        ([], "No stretch was named"),
        ([(5.0, 5.0)], "5:5 is not a stretch"),
        ([(7.0, 2.0)], "7:2 is not a stretch"),
        ([(-1.0, 2.0)], "is not a stretch"),
        ([(np.nan, 2.0)], "is not a stretch"),
        ([(200.0, 230.0)], "there are 0 samples; 32 are needed. The record lasts 119.99 s"),
        ([(0.0, 0.1)], "there are 10 samples"),
    ],
)
def test_a_stretch_that_is_none_is_refused(spans_s: list[tuple[float, float]], words: str) -> None:
    with pytest.raises(RecordingError, match=words):
        rests_in_spans(Recording(NOISE, rate_hz=RATE_HZ), spans_s)


def real(file: str) -> Path:
    path = DATA / file
    if not path.exists():
        pytest.skip(f"the recordings are not beside the project ({file})")
    return path


def broad(file: str) -> tuple[dict[str, Floats], Booleans]:
    """Return acceleration and rate, and the optical mask of rests."""
    path = real(f"broad/{file}")
    if path.suffix == ".mat":
        from scipy.io import loadmat

        held = loadmat(path)
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path) as opened:
            held = {name: opened[name][:] for name in ("imu_acc", "imu_gyr", "movement")}
    return {name: held[name] for name in ("imu_acc", "imu_gyr")}, np.ravel(held["movement"]) == 0


@pytest.mark.parametrize(
    "file",
    [
        "04_undisturbed_slow_rotation_with_breaks_A.mat",
        "05_undisturbed_slow_rotation_with_breaks_B.hdf5",
        "15_undisturbed_fast_translation_A.hdf5",
    ],
)
@pytest.mark.parametrize("name", ["imu_acc", "imu_gyr"])
def test_rests_of_a_hand_held_sensor_are_those_that_the_cameras_saw(file: str, name: str) -> None:
    sensors, still = broad(file)
    samples = sensors[name]
    for channels in ([0, 1, 2], [0], [1], [2]):
        found = detect_rests(Recording(samples[:, channels], rate_hz=2000 / 7))
        precision, recall = hits(found, still)
        assert precision > 0.999
        assert recall > 0.89


@pytest.mark.parametrize("file", ["xsens_acc.mat.txt.gz", "xsens_gyro.mat.txt.gz"])
def test_a_turned_sensor_rests_in_every_pose(file: str) -> None:
    """Motionless for forty seconds, then in some three dozen poses of a few seconds."""
    table = np.loadtxt(real(f"imu_tk/{file}"))
    found = detect_rests(Recording(table[:, 1:], times_s=table[:, 0]))
    since_s = table[:, 0] - table[0, 0]
    assert found.mask(len(table))[since_s < 40].all()
    assert 30 <= len(found.stretches) <= 50


def test_a_quiet_start_is_found() -> None:
    """Ten seconds on a table before it is picked up; the accelerometer feels something in the first of them."""
    table = np.loadtxt(real("fusion/sensor_data.csv"), delimiter=",", skiprows=1)
    for columns in (slice(1, 4), slice(4, 7)):
        found = detect_rests(Recording(table[:, columns], times_s=table[:, 0]))
        assert found.mask(len(table))[(table[:, 0] > 1.5) & (table[:, 0] < 9)].all()
        assert found.mask(len(table)).mean() < 0.5


@pytest.mark.parametrize("file", ["accelerometer.csv", "gyroscope.csv", "can_speed.csv"])
def test_a_car_on_a_motorway_never_rests(file: str) -> None:
    with real(f"comma2k19/{file}").open(encoding="utf-8") as opened:
        table = np.array(list(csv.reader(opened))[1:], dtype=float)
    width = table.shape[1] - 1
    for channels in (list(range(width)), *([c] for c in range(width))):
        found = detect_rests(Recording(table[:, 1:][:, channels], times_s=table[:, 0]))
        assert found.stretches == (), found.reason
