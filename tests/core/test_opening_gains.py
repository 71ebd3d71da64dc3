"""Gains before a filter has run: what first readings tell, what follows, where it settles, and leaps to there."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.model.covariances import gain_before
from becalm.core.model.model import Model
from becalm.core.steady.opening_gains import covariance_map, determine_state, gains_after
from becalm.core.steady.steady_filter import steady
from becalm.errors import ModelError

ORDERS = (1, 2, 3, 4, 5)


def differencing(order: int, ratio: float = 0.01) -> Model:
    """Return a model whose n-th difference of the level is white: noise enters the last state alone."""
    last = np.zeros((order, 1))
    last[-1] = 1
    return Model(F=np.eye(order) + np.eye(order, k=1), H=np.eye(1, order), G=last, Q=[[ratio]], R=[[2.0]])


def turning() -> Model:
    return Model(F=[[0.9, -0.3], [0.3, 0.9]], H=[[1, 0.2]], Q=0.1 * np.eye(2), R=[[0.5]])


MODELS = {**{f"order {order}": differencing(order) for order in ORDERS}, "turning": turning()}


@pytest.mark.parametrize("order", ORDERS)
def test_first_readings_of_a_polynomial_tell_its_state(order: int) -> None:
    """A state that moves without noise makes a polynomial; its last state is what the weights make of readings."""
    model, rng = differencing(order), np.random.default_rng(order)
    opening = determine_state(model)
    x, readings = rng.normal(size=order), []
    for k in range(len(opening.weights)):
        x = model.F @ x if k else x
        readings.append(float((model.H @ x)[0]))
    assert len(readings) == order
    np.testing.assert_allclose(opening.weights.T @ np.array(readings), x, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_an_opening_is_the_best_that_one_large_gaussian_tells(name: str) -> None:
    """All first readings at once: z = A x + B w + v of the last state x, by generalised least squares."""
    model = MODELS[name]
    opening, backward = determine_state(model), np.linalg.inv(model.F)
    rows, n = opening.weights.shape
    back = [np.linalg.matrix_power(backward, many) for many in range(rows)]
    A = np.vstack([model.H @ back[rows - 1 - k] for k in range(rows)])
    B = np.zeros((rows, rows * n))
    for k in range(rows):
        for j in range(k, rows - 1):
            B[k, j * n : (j + 1) * n] = -model.H @ back[j + 1 - k]
    C = B @ np.kron(np.eye(rows), model.process_covariance) @ B.T + model.R[0, 0] * np.eye(rows)
    weighed = np.linalg.solve(C, A)
    P = np.linalg.inv(A.T @ weighed)
    np.testing.assert_allclose(opening.P, P, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(opening.weights, weighed @ P, rtol=1e-8, atol=1e-9)


def riccati(P: Floats, model: Model) -> Floats:
    """Return the covariance before the next reading, of that before this one, by the textbook."""
    K = P @ model.H.T @ np.linalg.inv(model.H @ P @ model.H.T + model.R)
    after = P - K @ model.H @ P
    return np.asarray(model.F @ after @ model.F.T + model.process_covariance)


@pytest.mark.parametrize("name", MODELS)
def test_gains_after_settle_where_the_riccati_equation_does(name: str) -> None:
    model = MODELS[name]
    found = gains_after(determine_state(model), model, 5000)
    assert found.settled
    assert 5 < len(found.K) < 5000
    np.testing.assert_allclose(found.K[-1], steady(model).gain[:, 0], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", MODELS)
def test_gains_after_are_those_of_the_riccati_equation_row_by_row(name: str) -> None:
    model = MODELS[name]
    opening = determine_state(model)
    found = gains_after(opening, model, 40)
    P = model.F @ opening.P @ model.F.T + model.process_covariance
    for gain in found.K:
        np.testing.assert_allclose(gain, gain_before(P, model)[:, 0], rtol=1e-8, atol=1e-12)
        P = riccati(P, model)


def test_gains_that_have_not_settled_are_given_up() -> None:
    model = differencing(2, 1e-9)
    found = gains_after(determine_state(model), model, 30)
    assert not found.settled
    assert len(found.K) == 30


@pytest.mark.parametrize("name", MODELS)
def test_a_leap_is_a_riccati_step_and_twice_is_two(name: str) -> None:
    model, rng = MODELS[name], np.random.default_rng(4)
    once = covariance_map(model)
    A = rng.normal(size=(model.states, model.states))
    for P in (A @ A.T, steady(model).predicted_cov, np.zeros_like(A)):
        one = riccati(P, model)
        np.testing.assert_allclose(once.over(P), one, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(once.twice().over(P), riccati(one, model), rtol=1e-9, atol=1e-12)
        eight, step = once.twice().twice().twice(), P
        for _ in range(8):
            step = riccati(step, model)
        np.testing.assert_allclose(eight.over(P), step, rtol=1e-8, atol=1e-12)


def test_what_cannot_be_taken_back_is_refused() -> None:
    with pytest.raises(ModelError, match="F has no inverse"):
        determine_state(Model(F=[[0]], H=[[1]], Q=[[1]], R=[[1]]))
