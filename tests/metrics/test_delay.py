"""Lag and overshoot, read off records whose delay is known."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.metrics.delay import follow, lag_of

T = np.arange(4000)


def wave(at: np.ndarray) -> np.ndarray:
    return np.asarray(np.sin(at / 20) + 0.5 * np.sin(at / 31 + 1))


@pytest.mark.parametrize("samples", [0.0, 3.0, 7.5, -4.25])
def test_the_lag_of_a_shifted_wave_is_its_shift(samples: float) -> None:
    noise = 0.05 * np.random.default_rng(2).normal(size=len(T))
    assert lag_of(wave(T - samples) + noise, wave(T)) == pytest.approx(samples, abs=0.1)
    assert lag_of(np.where(T < 50, np.nan, wave(T - samples)), wave(T)) == pytest.approx(samples, abs=0.1)


def test_an_exponential_follows_a_step_as_its_time_constant_says() -> None:
    risen = np.where(T < 100, 2.0, 2.0 + 3.0 * (1 - np.exp(-(T - 99.0) / 25)))
    found = follow(risen, 100, 2.0, 5.0)
    assert found.delay_50 == pytest.approx(25 * np.log(2) - 0.5, abs=0.01)
    assert found.delay_90 == pytest.approx(25 * np.log(10) - 0.9, abs=0.01)
    assert found.overshoot == 0


def test_a_step_that_is_followed_at_once_has_no_delay_and_one_never_reached_has_no_end() -> None:
    step = np.where(T < 100, 0.0, 1.0)
    assert follow(step, 100, 0.0, 1.0) == (0.0, 0.0, 0.0)
    assert follow(0.7 * step, 100, 0.0, 1.0).delay_90 == np.inf
    assert follow(1.2 * step, 100, 0.0, 1.0).overshoot == pytest.approx(0.2)
    assert follow(-step, 100, 0.0, -1.0) == (0.0, 0.0, 0.0)


def test_no_lag_is_told_where_the_farthest_differs_least() -> None:
    rng = np.random.default_rng(6)
    told = [lag_of(np.cumsum(rng.normal(size=10)), np.cumsum(rng.normal(size=10))) for _ in range(300)]
    assert np.isnan(told).any()
    assert np.nanmax(np.abs(told)) <= 4.5
