"""The noise at rest is measured with an honest standard error, and what is no noise does not count."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.errors import RecordingError
from becalm.identification.at_rest.detection import Stretch
from becalm.identification.at_rest.rest_noise import RestNoise, noise_at_rest, split_at_cutoff

COUNT = 20_000
NOISE = np.random.default_rng(0).normal(size=COUNT)
WHOLE = [Stretch(0, COUNT)]


def measured(z: Floats, stretches: list[Stretch] | None = None) -> RestNoise:
    return noise_at_rest(Recording(z, rate_hz=100.0), stretches or [Stretch(0, len(z))])[0]


def test_the_standard_error_is_that_of_many_records() -> None:
    """Of 400 records the errors over their standard errors have the spread of one; so does the closed form."""
    rng = np.random.default_rng(1)
    found = [measured(3 * rng.normal(size=1000)) for _ in range(400)]
    errors = np.array([noise.variance - 9 for noise in found])
    spread = np.array([noise.standard_error for noise in found])
    assert np.sqrt(np.mean((errors / spread) ** 2)) == pytest.approx(1, abs=0.12)
    assert errors.mean() == pytest.approx(0, abs=4 * errors.std() / 20)
    assert np.mean(spread) == pytest.approx(9 * np.sqrt(3 / 999), rel=0.02)


def test_the_standard_error_knows_heavy_tails() -> None:
    rng = np.random.default_rng(2)
    found = [measured(rng.laplace(size=2000)) for _ in range(400)]
    errors = np.array([noise.variance - 2 for noise in found])
    spread = np.array([noise.standard_error for noise in found])
    assert errors.std() / spread.mean() == pytest.approx(1, abs=0.12)
    assert spread.mean() > 1.3 * 2 * np.sqrt(3 / 1999)


def test_drift_and_offset_do_not_count() -> None:
    still = measured(NOISE)
    drifting = measured(1e4 + NOISE + np.linspace(0, 50, COUNT))
    assert drifting.variance == pytest.approx(still.variance, rel=1e-3)
    assert drifting.slowness == pytest.approx(still.slowness, rel=0.02)


def test_spikes_do_not_count() -> None:
    z = NOISE.copy()
    z[100:COUNT:200] += 40.0
    still, spiked = measured(NOISE), measured(z)
    assert still.spikes == 0
    assert spiked.spikes == 200
    assert spiked.differences == COUNT - 1 - 200
    assert spiked.variance == pytest.approx(still.variance, rel=0.02)
    assert spiked.slowness == pytest.approx(1, abs=0.05)


def test_only_neighbours_within_a_stretch_are_compared() -> None:
    """Two stretches at other levels, a missing reading, and a gap in time."""
    z = np.where(np.arange(COUNT) < COUNT // 2, NOISE, NOISE + 3.0)
    z[500] = np.nan
    elapsed = np.ones(COUNT)
    elapsed[1000] = 50.0
    recording = Recording(z, times_s=np.cumsum(elapsed) / 100)
    found = noise_at_rest(recording, [Stretch(0, COUNT // 2), Stretch(COUNT // 2, COUNT)])[0]
    assert found.differences == COUNT - 1 - 1 - 2 - 1
    steps = np.diff(NOISE)
    assert found.variance == pytest.approx(
        np.mean(np.delete(steps, [499, 500, 999, COUNT // 2 - 1]) ** 2) / 2, rel=1e-12
    )


@pytest.mark.parametrize("pole", [0.0, 0.5, 0.8, -0.3])
def test_slowness_is_that_of_the_noise(pole: float) -> None:
    """Differences see 1 - pole of the variance of first-order noise; 48 readings about their mean, nearly all."""
    found = measured(lfilter([1.0], [1.0, -pole], NOISE))
    lags = np.arange(1, 48)
    of_mean = (1 + 2 * np.sum((1 - lags / 48) * pole**lags)) / 48
    assert found.slowness == pytest.approx((1 - of_mean) * 48 / 47 / (1 - pole), rel=0.06)


@pytest.mark.parametrize("quantum", [0.5, 1.0, 2.0])
def test_rounding_adds_its_own_variance(quantum: float) -> None:
    """A twelfth of the step squared, as long as the noise spans it."""
    found = measured(quantum * np.round(NOISE / quantum))
    assert found.variance == pytest.approx(1 + quantum**2 / 12, rel=0.04)


def test_each_channel_has_its_own_noise() -> None:
    z = np.column_stack([NOISE, 5 * NOISE[::-1], np.full(COUNT, 2.0), np.full(COUNT, np.nan)])
    found = noise_at_rest(Recording(z, names=["a", "b", "c", "d"], rate_hz=100.0), WHOLE)
    assert [noise.name for noise in found] == ["a", "b", "c", "d"]
    assert found[1].variance == pytest.approx(25 * found[0].variance, rel=1e-9)
    assert found[2].variance == 0.0
    assert np.isnan(found[3].variance)


def test_without_rest_nothing_is_measured() -> None:
    with pytest.raises(RecordingError, match="no rest to measure"):
        noise_at_rest(Recording(NOISE, rate_hz=100.0), [])
    assert np.isnan(measured(NOISE[:32]).variance)
    assert measured(NOISE[:33]).differences == 32


def test_white_noise_is_split_by_the_noise_bandwidth_of_the_filter() -> None:
    """Below 1 Hz passes pi / (2 sqrt 2) Hz of the 50 Hz; four standard errors of 8000 s are 7 %."""
    rng = np.random.default_rng(3)
    split = [split_at_cutoff(7 + 2 * rng.normal(size=200_000), 100.0) for _ in range(4)]
    below = np.mean([part.process_variance for part in split])
    assert below == pytest.approx(4 * np.pi / (2 * np.sqrt(2)) / 50, rel=0.07)
    assert np.mean([part.noise_variance for part in split]) == pytest.approx(4 - 4 * 0.0222, rel=0.015)


def test_the_split_tells_slow_from_fast() -> None:
    t = np.arange(100_000) / 1e3
    split = split_at_cutoff(3 * np.sin(2 * np.pi * 0.1 * t) + np.sin(2 * np.pi * 50 * t), 1e3)
    assert split.process_variance == pytest.approx(4.5, rel=0.02)
    assert split.noise_variance == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize(
    ("readings", "cutoff_hz", "words"),
    [
        (np.append(NOISE, np.nan), 1.0, "with gaps"),
        (NOISE, 50.0, "cutoff_hz = 50 is not a cut-off at 100 Hz"),
        (NOISE, 0.0, "cutoff_hz = 0"),
        (NOISE, np.nan, "cutoff_hz = nan"),
        (NOISE[:999], 1.0, "9.99 s are too short to be split at 1 Hz; 10 s are needed"),
    ],
)
def test_what_cannot_be_split_is_refused(readings: Floats, cutoff_hz: float, words: str) -> None:
    with pytest.raises(RecordingError, match=words):
        split_at_cutoff(readings, 100.0, cutoff_hz)
