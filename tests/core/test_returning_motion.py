"""A motion that returns to its level: its steps, its power, and what it predicts where no reading comes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov

from becalm.core.closed_forms import motion_power, returning_power
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import LEVEL_RATE, bias, motion, oscillator, returning_motion, with_walking_level
from becalm.errors import ModelError

ORDERS = (1, 2, 3, 4, 5)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("damping", [1e-4, 0.03, 2.0])
def test_its_steps_are_the_integrals_by_quadrature(order: int, damping: float) -> None:
    part = returning_motion(order, 2.0, damping)
    W = part.noise_input @ part.noise_density @ part.noise_input.T
    for T in (0.01, 1.0, 7.5):
        F, Q = part.over(np.array([T]))
        np.testing.assert_allclose(F[0], expm(part.drift * T), rtol=1e-11, atol=1e-13)
        nodes, weights = np.polynomial.legendre.leggauss(40)
        driven = [expm(part.drift * T * (node + 1) / 2) for node in nodes]
        expected = sum(T / 2 * w * (E @ W @ E.T) for w, E in zip(weights, driven, strict=True))
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(Q[0] / scale, expected / scale, rtol=0, atol=1e-9)


@pytest.mark.parametrize("order", ORDERS)
def test_a_long_step_is_many_short_ones(order: int) -> None:
    part = returning_motion(order, 1.0, 0.2)
    (short, long), (Q_short, Q_long) = part.over(np.array([1.0, 64.0]))
    Q = np.zeros_like(Q_short)
    for _ in range(64):
        Q = short @ Q @ short.T + Q_short
    np.testing.assert_allclose(long, np.linalg.matrix_power(short, 64), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(Q_long, Q, rtol=1e-9)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("damping", [0.02, 0.7])
def test_its_power_is_that_of_its_steps(order: int, damping: float) -> None:
    model = returning_motion(order, 1.0, damping).to_model(1.0, 1.0)
    angle = np.array([0.01, 0.1, 1.0, 3.0])
    states = np.linalg.inv(np.exp(1j * angle)[:, np.newaxis, np.newaxis] * np.eye(order + 1) - model.F)
    power = (model.H @ states @ model.process_covariance @ np.conj(np.swapaxes(states, 1, 2)) @ model.H.T)[:, 0, 0]
    np.testing.assert_allclose(returning_power(order, damping, LEVEL_RATE * damping, angle), power.real, rtol=1e-6)


@pytest.mark.parametrize("order", ORDERS)
def test_without_damping_it_is_the_motion(order: int) -> None:
    angle = np.array([0.05, 0.5, 2.0])
    np.testing.assert_array_equal(returning_power(order, 0.0, 0.0, angle), motion_power(order, angle))
    F, Q = returning_motion(order, 1.0, 1e-9).over(np.array([1.0]))
    F_other, Q_other = motion(order, 1.0).over(np.array([1.0]))
    np.testing.assert_allclose(F[0, :order, :order], F_other[0], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(Q[0, :order, :order], Q_other[0], rtol=1e-6)


@pytest.mark.parametrize("order", ORDERS)
def test_it_is_stationary_about_its_level_with_the_variance_of_its_note(order: int) -> None:
    q, a = 3.0, 0.05
    part = returning_motion(order, q, a)
    known = part.known
    assert known is not None
    np.testing.assert_allclose(known @ np.r_[1.0, np.zeros(order - 1), 1.0], 0.0, atol=1e-9 * np.abs(known).max())
    P = np.linalg.inv(known[:order, :order])
    np.testing.assert_allclose(P[0, 0], q / (2 * order * np.sin(np.pi / (2 * order)) * a ** (2 * order - 1)), rtol=1e-9)
    F, Q = part.over(np.array([1.0]))
    apart = np.eye(order + 1)
    apart[0, order] = -1.0
    chain = (apart @ F[0] @ np.linalg.inv(apart))[:order, :order]
    own = (apart @ Q[0] @ apart.T)[:order, :order]
    np.testing.assert_allclose(solve_discrete_lyapunov(chain, own)[0, 0], P[0, 0], rtol=1e-6)


def test_only_a_motion_that_returns_says_so() -> None:
    assert returning_motion(1, 1.0, 0.1).returns
    assert (returning_motion(3, 1.0, 0.1) + oscillator(0.1)).returns
    assert not any(part.returns for part in (motion(1), motion(3), bias(), oscillator(0.1, 0.02)))
    assert not (motion(2) + oscillator(0.1, 0.02)).returns


def test_a_level_that_jumps_takes_what_it_returns_to_along() -> None:
    part = with_walking_level(returning_motion(2, 1.0, 0.1), 4.0)
    np.testing.assert_array_equal(part.noise_input[:, -1], [1.0, 0.0, 1.0])


@pytest.mark.parametrize("damping", [0.0, -1.0, np.nan, np.inf])
def test_it_refuses_what_is_no_damping(damping: float) -> None:
    with pytest.raises(ModelError, match="damping"):
        returning_motion(2, 1.0, damping)


@pytest.mark.parametrize("order", ORDERS)
def test_predictions_return_to_the_level_and_sigma_to_the_spread(order: int) -> None:
    rng = np.random.default_rng(order)
    spread, damping = 1.0, 0.1
    q = spread**2 * 2 * order * np.sin(np.pi / (2 * order)) * damping ** (2 * order - 1)
    part = returning_motion(order, q, damping)
    F, Q = part.over(np.array([1.0]))
    scale = np.sqrt(np.diag(Q[0]))
    root = scale[:, np.newaxis] * np.linalg.cholesky(Q[0] / np.outer(scale, scale) + 1e-12 * np.eye(order + 1))
    x, truth = np.r_[50.0, np.zeros(order - 1), 50.0], np.empty(3000)
    for k in range(3000):
        x = F[0] @ x + root @ rng.normal(size=order + 1)
        truth[k] = x[0]
    z = truth + 0.01 * rng.normal(size=3000)
    z[1500:1800], z[2700:] = np.nan, np.nan
    model = part.to_model(1.0, 1e-4)
    for estimate in (kalman_filter(model, z), kalman_smoother(model, z)):
        signal, sigma = estimate.signal[:, 0], estimate.sigma[:, 0]
        seen = z[np.isfinite(z)]
        assert seen.min() - 0.1 < signal.min()
        assert signal.max() < seen.max() + 0.1
        assert 0.8 * spread < sigma[1650] < 2.0 * spread
        assert 0.9 * spread < sigma[2999] < 2.5 * spread
        error = np.abs(signal - truth)[1500:1800] / sigma[1500:1800]
        assert np.sqrt(np.mean(error**2)) < 2.5


@pytest.mark.parametrize("order", ORDERS)
def test_rows_before_the_first_reading_return_to_the_level_too(order: int) -> None:
    q = 2 * order * np.sin(np.pi / (2 * order)) * 0.3 ** (2 * order - 1)
    z = 50.0 + np.sin(np.arange(1000) / 5)
    z[:400] = np.nan
    told = kalman_smoother(returning_motion(order, q, 0.3).to_model(1.0, 1e-4), z)
    assert np.abs(told.signal[:400] - 50.0).max() < 1.5
    assert told.sigma[:400].max() < 6.0
    assert told.sigma[200, 0] > 0.8
