"""A wide P0: covariances would lose the readings' digits; the filter carries it as information instead."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.filter.filtering import kalman_filter, run_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import even_timeline
from becalm.core.online import Online
from becalm.core.reference import kalman as reference


def track(P0: float, R: float, q: float = 0.0) -> Model:
    return Model(F=[[1, 1], [0, 1]], H=[[1, 0]], Q=q * np.eye(2), R=R, x0=[1, 2], P0=P0 * np.eye(2))


@pytest.mark.parametrize(("P0", "R"), [(1e6, 1e-6), (1e8, 1e-8), (1e10, 1e-12), (1e20, 1e-12)])
def test_a_wide_prior_smooths_as_a_flat_start_does(P0: float, R: float) -> None:
    z = np.random.default_rng(1).normal(size=200)
    flat = Model(F=[[1, 1], [0, 1]], H=[[1, 0]], Q=np.zeros((2, 2)), R=R)
    wide, exact = kalman_smoother(track(P0, R), z), kalman_smoother(flat, z)
    np.testing.assert_allclose(wide.sigma, exact.sigma, rtol=1e-9)
    np.testing.assert_allclose(wide.signal, exact.signal, rtol=0, atol=1e-6 * exact.sigma.max())


@pytest.mark.parametrize(("P0", "R"), [(1e5, 1e-5), (1e4, 1e-6)])
def test_a_wide_prior_filters_as_the_reference_does(P0: float, R: float) -> None:
    z = np.random.default_rng(1).normal(size=(40, 1))
    z[3:5] = np.nan
    model = track(P0, R, q=1e-3)
    found = kalman_filter(model, z, states=True, covariances=True)
    steps = reference.filter_readings(
        reference.StateEstimate(np.array([1.0, 2.0]), model.P0 if model.P0 is not None else np.eye(2)),
        model.F,
        model.process_covariance,
        (model.H, model.R),
        z,
    )
    assert found.mean is not None
    expected = np.array([step.filtered.mean for step in steps])
    np.testing.assert_allclose(found.mean, expected, rtol=1e-7, atol=1e-7)
    assert found.log_likelihood == pytest.approx(sum(step.log_likelihood for step in steps), rel=1e-9)
    assert found.used == 38


def test_live_is_the_same_and_leaves_the_opening() -> None:
    model = track(1e4, 1e-6, q=1e-3)
    z = np.random.default_rng(2).normal(size=60)
    run = run_filter(model, even_timeline(model, 60), z[:, np.newaxis])
    assert run.determined_row == 2
    whole, _ = Online(model).run(z)
    np.testing.assert_allclose(whole, run.estimate.signal, rtol=1e-12)
    for cut in (0, 1, 2, 30):
        online = Online(model)
        first, _ = online.run(z[:cut])
        rest, _ = Online.resume(online.snapshot()).run(z[cut:])
        assert np.array_equal(np.vstack([first, rest]), whole)


def test_an_opening_that_never_ends_is_still_smoothed() -> None:
    found = kalman_smoother(track(1e8, 1e-8), np.array([3.0]))
    assert found.signal[0, 0] == pytest.approx(3.0, abs=1e-9)
    assert found.sigma[0, 0] == pytest.approx(1e-4, rel=1e-9)


def test_the_units_of_the_states_do_not_matter() -> None:
    z = np.random.default_rng(2).normal(size=200)
    one_unit = Model(F=[[1, 1], [0, 1]], H=[[1, 0]], Q=1e-3 * np.eye(2), R=1e-4, x0=[1, 2], P0=1e16 * np.eye(2))
    scale = np.diag([1.0, 1e8])  # the speed in another unit
    other = Model(
        F=scale @ one_unit.F @ np.linalg.inv(scale),
        H=one_unit.H,
        Q=scale @ one_unit.process_covariance @ scale,
        R=1e-4,
        x0=[1, 2e8],
        P0=1e16 * scale @ scale,
    )
    for run in (kalman_filter, kalman_smoother):
        found, expected = run(other, z), run(one_unit, z)
        np.testing.assert_allclose(found.sigma, expected.sigma, rtol=1e-9)
        np.testing.assert_allclose(found.signal, expected.signal, rtol=0, atol=1e-9)
