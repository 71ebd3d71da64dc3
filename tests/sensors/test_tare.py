"""A zero comes from a quiet stretch with an honest uncertainty, and from no other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.tare import FEWEST, zero_of

SEEDS = 400


def noise(seed: int, count: int = 800) -> Floats:
    return np.random.default_rng(seed).normal(0.0, 1.0, count)


def refused(stretch: Floats) -> bool:
    try:
        zero_of(stretch)
    except SensorError:
        return True
    return False


def test_the_zero_is_within_its_uncertainty() -> None:
    zeros = [zero_of(noise(seed) + 7.0) for seed in range(SEEDS)]
    pulls = np.array([(zero.value - 7.0) / zero.std for zero in zeros])
    assert np.mean(pulls**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / SEEDS))
    assert zeros[0].std == pytest.approx(1 / np.sqrt(800), rel=0.1)


@pytest.mark.parametrize("count", [FEWEST, 100, 3000])
def test_noise_alone_is_hardly_ever_refused(count: int) -> None:
    assert sum(refused(noise(seed, count)) for seed in range(SEEDS)) <= 3


STEADY = np.linspace(-0.5, 0.5, 800)
UNQUIET = {
    "a drift": 3 * STEADY,
    "a step": 1.0 * (STEADY > 0.2),
    "a bump": 4 * np.exp(-((STEADY / 0.05) ** 2)),
    "a knock": 15.0 * (np.abs(STEADY) < 0.01) * (-1.0) ** np.arange(800),
}


@pytest.mark.parametrize("kind", UNQUIET)
def test_what_is_not_quiet_is_refused(kind: str) -> None:
    assert all(refused(noise(seed) + UNQUIET[kind]) for seed in range(50))


def test_a_refusal_says_how_far_it_wanders() -> None:
    with pytest.raises(SensorError, match=r"not quiet: it drifts by 0\.9.*, its noise is 1\."):
        zero_of(noise(0) + UNQUIET["a drift"])


def test_a_small_drift_is_told_in_full() -> None:
    """Half a sigma from end to end: too little to refuse, but far more than the mean's own error."""
    zero = zero_of(noise(1, 8000) + 0.5 * np.linspace(-0.5, 0.5, 8000))
    assert zero.std > 0.1 > 5 / np.sqrt(8000)


def test_slow_noise_is_not_taken_for_white() -> None:
    """Noise that remembers ten readings: the mean's error is some times larger than white noise would say."""
    within, seeds = 0, 200
    for seed in range(seeds):
        white = noise(seed, 20_000)
        slow = np.convolve(white, np.ones(20) / np.sqrt(20), mode="valid")
        zero = zero_of(slow)
        within += abs(zero.value) < 2 * zero.std
    assert within >= 0.9 * seeds


@given(seed=st.integers(0, 1000), shift=st.floats(-1e6, 1e6), scale=st.floats(1e-3, 1e3))
def test_the_zero_knows_no_unit(seed: int, shift: float, scale: float) -> None:
    plain, moved = zero_of(noise(seed) * 1.0), zero_of(noise(seed) * scale + shift)
    assert moved.value == pytest.approx(plain.value * scale + shift, rel=1e-9, abs=1e-9 * scale)
    assert moved.std == pytest.approx(plain.std * scale, rel=1e-4)


def test_missing_readings_are_left_out() -> None:
    holed = noise(3)
    holed[::3] = np.nan
    assert zero_of(holed) == zero_of(holed[np.isfinite(holed)])


def test_of_readings_that_do_not_vary_no_uncertainty_is_told() -> None:
    value, std, readings = zero_of(np.full(100, 12.0))
    assert (value, readings) == (12.0, 100)
    assert np.isnan(std)


def test_too_few_readings_are_refused() -> None:
    with pytest.raises(SensorError, match="a zero needs 32"):
        zero_of(np.append(np.zeros(31), np.nan))
