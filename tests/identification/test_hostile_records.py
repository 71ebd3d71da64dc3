"""Records that are no signal at all: a choice is always made, in finite numbers, without a warning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.identification.choose import FEWEST_READINGS, Choice, choose

ROWS = 600
RNG = np.random.default_rng(12)
NOISE = RNG.normal(size=ROWS)
T = np.arange(float(ROWS))


def even(count: int) -> Floats:
    elapsed = np.ones(count)
    elapsed[:1] = 0.0
    return elapsed


def holed(z: Floats, share: float) -> Floats:
    return np.where(np.random.default_rng(13).random(len(z)) < share, np.nan, z)


def spiked(z: Floats) -> Floats:
    z = z.copy()
    z[::97] = 1e9
    return z


SIGNAL = np.sin(T / 30) + 0.1 * NOISE
HOSTILE = {
    "pure noise": NOISE,
    "noise on an offset": 1e6 + NOISE,
    "random walk without noise": np.cumsum(NOISE),
    "second integral without noise": np.cumsum(np.cumsum(NOISE)),
    "third integral without noise": np.cumsum(np.cumsum(np.cumsum(NOISE))),
    "ramp without noise": 0.1 * T,
    "ramp of whole numbers": T,
    "falling ramp on an offset": 1e5 - 0.3 * T,
    "parabola without noise": 1e-3 * T**2,
    "cubic without noise": 1e-6 * T**3,
    "sine without noise": np.sin(T / 20),
    "sine at half of the rate": (-1.0) ** T,
    "step": np.where(T < 300, 0.0, 1.0),
    "one spike": np.where(T == 300, 1.0, 0.0),
    "one other reading at the start": np.where(T == 0, 1.0, 0.0),
    "one other reading at the end": np.where(T == ROWS - 1, 1.0, 0.0),
    "huge spikes": spiked(SIGNAL),
    "quantised": np.round(SIGNAL, 0),
    "two values": np.sign(NOISE),
    "times 1e15": 1e15 * SIGNAL,
    "times 1e-15": 1e-15 * SIGNAL,
    "times 1e90": 1e90 * SIGNAL,
    "times 1e-90": 1e-90 * SIGNAL,
    "times 1e-150": 1e-150 * SIGNAL,
    "denormal": 1e-310 * SIGNAL,
    "far from zero": 1e12 + SIGNAL,
    "last bits only": 1.0 + np.finfo(float).eps * (NOISE > 0),
    "mostly missing": holed(SIGNAL, 0.95),
    "exponential": np.exp(T / 20),
    "heavy tails": RNG.standard_cauchy(ROWS),
}


def assert_sound(choice: Choice) -> None:
    assert choice.kind == "motion"
    assert choice.tuning is not None
    for tuning in choice.rivals:
        assert np.isfinite(tuning.ratio)
        assert tuning.ratio > 0
        assert np.isfinite(tuning.noise_variance)
        assert tuning.noise_variance > 0
        assert np.isfinite(tuning.log_likelihood)
    assert replace(choice.tuning, damping=0.0) in choice.rivals


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_record_is_tuned_soundly(name: str) -> None:
    z = HOSTILE[name]
    before = z.copy()
    assert_sound(choose(z, even(len(z))))
    assert np.array_equal(z, before, equal_nan=True)


@pytest.mark.parametrize("name", ["pure noise", "ramp without noise", "sine without noise", "step", "times 1e15"])
def test_a_hostile_record_is_tuned_soundly_in_irregular_time(name: str) -> None:
    elapsed = np.random.default_rng(14).exponential(size=ROWS)
    elapsed[[10, 11, 400]] = 0.0
    assert_sound(choose(HOSTILE[name], elapsed))


@pytest.mark.parametrize("value", [0.0, -3.7, 1e15, 1e-300])
@pytest.mark.parametrize("count", [8, 9, 1000])
def test_readings_that_are_all_equal_are_a_constant(value: float, count: int) -> None:
    z = np.full(count, value)
    assert choose(z, even(count)).kind == "constant"
    assert choose(np.append(z, np.nan), even(count + 1)).kind == "constant"


@pytest.mark.parametrize("count", range(FEWEST_READINGS))
def test_few_readings_are_untold(count: int) -> None:
    for z in (np.arange(float(count)), np.ones(count)):
        assert choose(z, even(count)).kind == "untold"
        assert choose(np.append(z, [np.nan] * 50), even(count + 50)).kind == "untold"


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("rows", [1, 2])
def test_stretches_of_two_tell_no_noise(rows: int, causal: bool) -> None:
    """Beside a level of its own each leaves one residual, of noise and motion together."""
    elapsed = np.where(np.arange(40) % rows == 0, 5000.0, 1.0)
    assert choose(NOISE[:40], elapsed, causal).kind == "untold"


def test_a_few_readings_that_can_be_foretold_tell_no_noise() -> None:
    """Ten stretches of three and one of five readings: two readings come after the first three."""
    elapsed = np.where((np.arange(35) % 3 == 0) & (np.arange(35) < 31), 5000.0, 1.0)
    assert choose(NOISE[:35], elapsed, causal=True).kind == "untold"
    assert choose(NOISE[:40], np.append(elapsed, np.ones(5)), causal=True).kind == "motion"


@pytest.mark.parametrize(("rows", "causal"), [(5, True), (5, False), (8, True)])
def test_short_stretches_tell_what_they_can(rows: int, causal: bool) -> None:
    elapsed = np.where(np.arange(ROWS) % rows == 0, 5000.0, 1.0)
    choice = choose(NOISE, elapsed, causal)
    assert choice.tuning is not None
    assert choice.tuning.count > 0
    assert choice.tuning.noise_variance == pytest.approx(1.0, rel=0.3)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", range(FEWEST_READINGS, 2 * FEWEST_READINGS))
def test_from_eight_readings_on_something_is_told(count: int, seed: int) -> None:
    assert_sound(choose(np.random.default_rng(seed).normal(size=count), even(count)))


@pytest.mark.parametrize("seed", range(5))
def test_pure_noise_is_averaged_nearly_over_the_record(seed: int) -> None:
    """The search ends at its slowest filter, and r is the noise's own variance."""
    choice = choose(3.0 * np.random.default_rng(seed).normal(size=5000), even(5000))
    assert choice.tuning is not None
    assert choice.tuning.noise_variance == pytest.approx(9.0, rel=0.1)
    assert choice.tuning.ratio ** (1 / (2 * choice.tuning.order)) < 0.02


def test_a_random_walk_without_noise_passes_unsmoothed() -> None:
    choice = choose(HOSTILE["random walk without noise"], even(ROWS))
    assert choice.tuning is not None
    assert choice.tuning.ratio ** (1 / (2 * choice.tuning.order)) > 2.0
