"""Stamped readings: the same as a fine even grid with nothing between them."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter, run_filter
from becalm.core.filter.smoothing import kalman_smoother, run_smoother
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import elapsed_timeline, even_timeline

GRID = 1e-10


def stamped(order: int, seed: int) -> tuple[Floats, Floats, Floats]:
    """Return elapsed grid steps (N,), readings (N, 1), and the fine record with NaN between them."""
    rng = np.random.default_rng(seed)
    elapsed = rng.integers(1, 9, size=120).astype(float)
    elapsed[0] = 0
    elapsed[60] = 70  # a gap
    z = np.cumsum(rng.normal(size=120))[:, np.newaxis]
    z[[0, 1, 30]] = np.nan
    rows = np.cumsum(elapsed).astype(int)
    fine = np.full((rows[-1] + 1, 1), np.nan)
    fine[rows] = z
    return elapsed, z, fine


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("smooth", [False, True])
def test_stamped_readings_are_a_fine_grid_with_gaps(order: int, smooth: bool) -> None:
    elapsed, z, fine = stamped(order, seed=order)
    density, variance, tick = 0.3, 0.5, 0.25
    part = motion(order, density)
    rows = np.cumsum(elapsed).astype(int)
    on_grid = (kalman_smoother if smooth else kalman_filter)(part.to_model(tick, variance), fine)
    timeline = elapsed_timeline(part, variance, elapsed * tick)
    got = (run_smoother if smooth else lambda *record: run_filter(*record).estimate)(
        part.to_model(1.0, variance), timeline, z
    )
    for name in ("signal", "sigma", "innovations", "innovation_sigma"):
        expected = getattr(on_grid, name)[rows]
        scale = np.abs(expected[np.isfinite(expected)]).max()
        np.testing.assert_allclose(getattr(got, name), expected, rtol=GRID, atol=GRID * scale)
    assert got.used == on_grid.used
    assert got.log_likelihood == pytest.approx(on_grid.log_likelihood, rel=GRID)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_even_stamps_are_the_even_timeline(order: int) -> None:
    model, z = motion(order, 0.1).to_model(1.0, 0.4), np.random.default_rng(1).normal(size=(500, 1))
    elapsed = np.ones(500)
    elapsed[0] = 0.0
    stamps = run_filter(model, elapsed_timeline(motion(order, 0.1), 0.4, elapsed), z).estimate
    even = run_filter(model, even_timeline(model, 500), z).estimate
    assert np.array_equal(stamps.signal, even.signal, equal_nan=True)
    assert np.array_equal(stamps.sigma, even.sigma)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_two_readings_at_one_time_are_their_mean_with_half_the_variance(order: int) -> None:
    rng = np.random.default_rng(2)
    z = rng.normal(size=(50, 2))
    part = motion(order, 0.2)
    elapsed = np.tile([1.0, 0.0], 50)
    elapsed[0] = 0.0
    twice = run_smoother(part.to_model(1.0, 0.6), elapsed_timeline(part, 0.6, elapsed), z.reshape(-1, 1))
    once = kalman_smoother(part.to_model(1.0, 0.3), z.mean(axis=1))
    for half in (0, 1):
        np.testing.assert_allclose(twice.signal[half::2], once.signal, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(twice.sigma[half::2], once.sigma, rtol=1e-9)


def test_no_time_at_all_is_the_mean_of_the_readings() -> None:
    z = np.array([[1.0], [2.0], [6.0]])
    part = motion(1, 5.0)
    got = run_filter(part.to_model(1.0, 0.3), elapsed_timeline(part, 0.3, np.zeros(3)), z).estimate
    np.testing.assert_allclose(got.signal[:, 0], [1.0, 1.5, 3.0], rtol=1e-12)
    np.testing.assert_allclose(got.sigma[:, 0] ** 2, [0.3, 0.15, 0.1], rtol=1e-12)


@pytest.mark.parametrize("count", [0, 1])
@pytest.mark.parametrize("order", [1, 3])
def test_the_shortest_records(count: int, order: int) -> None:
    part = motion(order)
    z = np.full((count, 1), 4.0)
    for run in (lambda *record: run_filter(*record).estimate, run_smoother):
        got = run(part.to_model(1.0, 0.25), elapsed_timeline(part, 0.25, np.zeros(count)), z)
        assert np.array_equal(got.signal, z)
        assert np.array_equal(got.sigma, np.full((count, 1), 0.5))


def test_sigma_grows_across_a_gap_and_is_least_beside_readings() -> None:
    model: Model = motion(2, 0.01).to_model(1.0, 1.0)
    z = np.zeros(300)
    z[100:200] = np.nan
    causal, smoothed = kalman_filter(model, z).sigma[:, 0], kalman_smoother(model, z).sigma[:, 0]
    assert (np.diff(causal[99:200]) > 0).all()
    assert np.argmax(smoothed[90:210]) + 90 in (149, 150)
    assert (smoothed <= causal * (1 + 1e-12)).all()
