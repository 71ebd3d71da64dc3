"""Components: exact discretisation against exponential and quadrature, sums, and refusals."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from becalm.core import components
from becalm.core.arrays import Floats
from becalm.core.components import Component, discretise, level, motion
from becalm.errors import ModelError

STEPS = [1e-4, 0.01, 1.0, 30.0]


def oscillator(frequency: float = 2.0, damping: float = 0.1) -> Component:
    drift = np.array([[0.0, 1.0], [-(frequency**2), -2 * damping * frequency]])
    return Component(drift, np.array([[0.0], [1.0]]), np.array([[0.4]]), np.array([[1.0, 0.0]]), ("place", "speed"))


def integrated(component: Component, T: float) -> Floats:
    """Q by quadrature of expm(A s) B W B' expm(A s)'."""
    W = component.noise_input @ component.noise_density @ component.noise_input.T

    def spread(s: float) -> Floats:
        turn: Floats = expm(component.drift * s)
        grown: Floats = turn @ W @ turn.T
        return grown

    Q: Floats = quad_vec(spread, 0.0, T, epsabs=0.0, epsrel=1e-12)[0]
    return Q


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("T", STEPS)
def test_a_motion_is_discretised_exactly(order: int, T: float) -> None:
    F, Q = discretise(motion(order, 2.5), np.array([T]))
    np.testing.assert_allclose(F[0], expm(motion(order).drift * T), rtol=1e-12)
    place = np.arange(order)
    closed = np.array(
        [
            [
                2.5
                * T ** (2 * order - 1 - i - j)
                / ((2 * order - 1 - i - j) * factorial(order - 1 - i) * factorial(order - 1 - j))
                for j in place
            ]
            for i in place
        ]
    )
    np.testing.assert_allclose(Q[0], closed, rtol=1e-13)
    np.testing.assert_allclose(Q[0], integrated(motion(order, 2.5), T), rtol=1e-9)


@pytest.mark.parametrize("T", [0.01, 0.3, 2.0])
def test_a_resonance_is_discretised_exactly(T: float) -> None:
    F, Q = discretise(oscillator(), np.array([T]))
    np.testing.assert_allclose(F[0], expm(oscillator().drift * T), rtol=1e-12)
    np.testing.assert_allclose(Q[0], integrated(oscillator(), T), rtol=1e-10, atol=1e-18)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_the_polynomial_road_is_van_loans_road(order: int) -> None:
    part = motion(order, 0.7)
    W = part.noise_input @ part.noise_density @ part.noise_input.T
    steps = np.array([0.0, 0.01, 1.0, 2.5])
    F, Q = components._integrate_polynomial(part.drift, W, steps)
    F_other, Q_other = components._integrate_van_loan(part.drift, W, steps)
    np.testing.assert_allclose(F, F_other, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(Q, Q_other, rtol=1e-11, atol=1e-13)


def test_several_steps_are_each_their_own() -> None:
    steps = np.array([0.0, 0.5, 2.0])
    for part in (motion(3, 0.2), oscillator()):
        F, Q = discretise(part, steps)
        for k, T in enumerate(steps):
            alone = discretise(part, np.array([T]))
            np.testing.assert_allclose(F[k], alone[0][0], rtol=1e-13, atol=1e-15)
            np.testing.assert_allclose(Q[k], alone[1][0], rtol=1e-13, atol=1e-15)
        assert np.array_equal(F[0], np.eye(len(part.drift)))
        assert not Q[0].any()


@pytest.mark.parametrize("part", [motion(2, 0.3), motion(4, 0.3), oscillator()], ids=["slope", "jerk", "resonance"])
def test_two_steps_are_one_long_step(part: Component) -> None:
    F, Q = discretise(part, np.array([0.4, 0.8]))
    np.testing.assert_allclose(F[0] @ F[0], F[1], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(F[0] @ Q[0] @ F[0].T + Q[0], Q[1], rtol=1e-11, atol=1e-14)


def test_a_sum_is_two_independent_parts_whose_outputs_add() -> None:
    both = motion(2, 0.3) + oscillator()
    model = both.to_model(0.1, 0.5)
    first, second = motion(2, 0.3).to_model(0.1, 0.5), oscillator().to_model(0.1, 0.5)
    np.testing.assert_allclose(model.F[:2, :2], first.F, rtol=1e-12)
    np.testing.assert_allclose(model.F[2:, 2:], second.F, rtol=1e-12)
    np.testing.assert_allclose(model.process_covariance[:2, :2], first.process_covariance, rtol=1e-11)
    np.testing.assert_allclose(model.process_covariance[2:, 2:], second.process_covariance, rtol=1e-11)
    assert not model.F[:2, 2:].any()
    assert not model.F[2:, :2].any()
    assert not model.process_covariance[:2, 2:].any()
    assert np.array_equal(model.H, [[1, 0, 1, 0]])
    assert both.state_names == ("level", "velocity", "place", "speed")


def test_a_sum_of_motions_keeps_the_polynomial_road() -> None:
    F, Q = discretise(motion(3, 0.3) + level(2.0), np.array([0.5]))
    np.testing.assert_allclose(Q[0, :3, :3], discretise(motion(3, 0.3), np.array([0.5]))[1][0], rtol=1e-14)
    assert Q[0, 3, 3] == 1.0
    assert F[0, 3, 3] == 1.0


def test_a_level_is_a_motion_of_order_one() -> None:
    model = level(3.0).to_model(0.25, 2.0)
    assert (model.F.item(), model.Q.item(), model.H.item(), model.R.item()) == (1.0, 0.75, 1.0, 2.0)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_every_order_sees_its_first_state_and_is_observable(order: int) -> None:
    model = motion(order).to_model(0.1, 1.0)
    assert model.states == order == len(motion(order).state_names)
    assert np.array_equal(model.H, np.eye(1, order))
    assert model.observable_states == (True,) * order


def test_the_euler_form_is_the_first_order_form() -> None:
    model = motion(3, 2.0).to_model(0.1, 1.0, discretisation="euler")
    np.testing.assert_allclose(model.F, np.eye(3) + 0.1 * np.eye(3, k=1), rtol=1e-15)
    assert np.array_equal(model.G, [[0.0], [0.0], [0.1]])
    assert np.array_equal(model.Q, [[2.0]])


@pytest.mark.parametrize("order", [0, -1, 6, 1.5])
def test_other_orders_are_refused(order: Any) -> None:
    with pytest.raises(ModelError, match=r"^order = .* is not offered; choose 1"):
        motion(order)


@pytest.mark.parametrize("density", [-1.0, np.nan, np.inf])
def test_what_is_not_a_density_is_refused(density: float) -> None:
    with pytest.raises(ModelError, match=r"^noise_density = "):
        motion(1, density)


@pytest.mark.parametrize("step_s", [0.0, -0.1, np.nan, np.inf])
def test_what_is_not_a_step_is_refused(step_s: float) -> None:
    with pytest.raises(ModelError, match=r"^step_s = "):
        level().to_model(step_s, 1.0)


def test_a_negative_variance_and_an_unknown_form_are_refused() -> None:
    with pytest.raises(ModelError, match=r"^R is not a covariance"):
        level().to_model(1.0, -1.0)
    unknown: Any = "tustin"
    with pytest.raises(ModelError, match=r"^discretisation = 'tustin' is not known"):
        level().to_model(1.0, 1.0, discretisation=unknown)
