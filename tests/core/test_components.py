"""Components: exact discretisation against exponential and quadrature, sums, and refusals."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm, solve_discrete_lyapunov

from becalm.core.arrays import Floats
from becalm.core.model import discretisation
from becalm.core.model.components import Component, Part, bias, gauss_markov, hum, level, motion
from becalm.core.model.components import oscillator as tone
from becalm.errors import ModelError

STEPS = [1e-4, 0.01, 1.0, 30.0]
RESONANCE = Part("resonance", ("place", "speed"))


def oscillator(frequency: float = 2.0, damping: float = 0.1) -> Component:
    drift = np.array([[0.0, 1.0], [-(frequency**2), -2 * damping * frequency]])
    return Component(drift, np.array([[0.0], [1.0]]), np.array([[0.4]]), np.array([[1.0, 0.0]]), (RESONANCE,))


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
    F, Q = motion(order, 2.5).over(np.array([T]))
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
    F, Q = oscillator().over(np.array([T]))
    np.testing.assert_allclose(F[0], expm(oscillator().drift * T), rtol=1e-12)
    np.testing.assert_allclose(Q[0], integrated(oscillator(), T), rtol=1e-10, atol=1e-18)


@pytest.mark.parametrize(("fades", "turns"), [(0.0, 0.3), (1e-9, 1e-6), (1e-4, 0.3), (0.5, 3.0), (2.0, 0.0)])
def test_the_road_of_a_tone_is_that_of_a_series(fades: float, turns: float) -> None:
    A, W = np.array([[-fades, turns], [-turns, -fades]]), 0.7 * np.eye(2)
    steps = np.array([0.0, 1e-6, 0.1, 1.0, 7.5, 300.0])
    for size in (1, 2):
        F, Q = discretisation.discretise(A[:size, :size], W[:size, :size], steps)
        F_other, Q_other = discretisation._integrate_series(A[:size, :size], W[:size, :size], steps)
        np.testing.assert_allclose(F, F_other, rtol=0, atol=1e-13)
        np.testing.assert_allclose(Q, Q_other, rtol=0, atol=1e-13 * np.abs(Q_other).max())


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_the_polynomial_road_is_that_of_a_series(order: int) -> None:
    part = motion(order, 0.7)
    W = part.noise_input @ part.noise_density @ part.noise_input.T
    steps = np.array([0.0, 0.01, 1.0, 2.5])
    F, Q = discretisation._integrate_polynomial(part.drift, W, steps)
    F_other, Q_other = discretisation._integrate_series(part.drift, W, steps)
    np.testing.assert_allclose(F, F_other, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(Q, Q_other, rtol=1e-11, atol=1e-13)


def test_several_steps_are_each_their_own() -> None:
    steps = np.array([0.0, 0.5, 2.0])
    for part in (motion(3, 0.2), oscillator()):
        F, Q = part.over(steps)
        for k, T in enumerate(steps):
            alone = part.over(np.array([T]))
            np.testing.assert_allclose(F[k], alone[0][0], rtol=1e-13, atol=1e-15)
            np.testing.assert_allclose(Q[k], alone[1][0], rtol=1e-13, atol=1e-15)
        assert np.array_equal(F[0], np.eye(len(part.drift)))
        assert not Q[0].any()


@pytest.mark.parametrize("part", [motion(2, 0.3), motion(4, 0.3), oscillator()], ids=["slope", "jerk", "resonance"])
def test_two_steps_are_one_long_step(part: Component) -> None:
    F, Q = part.over(np.array([0.4, 0.8]))
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
    F, Q = (motion(3, 0.3) + level(2.0)).over(np.array([0.5]))
    np.testing.assert_allclose(Q[0, :3, :3], motion(3, 0.3).over(np.array([0.5]))[1][0], rtol=1e-14)
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


@pytest.mark.parametrize("order", [0, -1, 6, 1.5, True, "2", None, np.nan, 2.0])
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
    with pytest.raises(ModelError, match=r"^noise_variance = -1.0 is not a variance; give a number in unit\^2 or 0"):
        level().to_model(1.0, -1.0)
    unknown: Any = "tustin"
    with pytest.raises(ModelError, match=r"^discretisation = 'tustin' is not known"):
        level().to_model(1.0, 1.0, discretisation=unknown)


@pytest.mark.parametrize("bandwidth_hz", [0.0, 0.3, 40.0])
@pytest.mark.parametrize("T", [0.01, 0.3])
def test_a_tone_turns_and_shrinks(bandwidth_hz: float, T: float) -> None:
    """In closed form: a rotation times exp(-pi B T), and noise of the same variance on both states."""
    F, Q = tone(2.0, bandwidth_hz, 0.4).over(np.array([T]))
    angle, shrunk = 4 * np.pi * T, np.exp(-np.pi * bandwidth_hz * T)
    rotation = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    np.testing.assert_allclose(F[0], shrunk * np.array(rotation), rtol=1e-11, atol=1e-13)
    variance = 0.4 * (1 - shrunk**2) / (2 * np.pi * bandwidth_hz) if bandwidth_hz else 0.4 * T
    np.testing.assert_allclose(Q[0], variance * np.eye(2), rtol=1e-11, atol=1e-13 * variance)


def test_a_damped_tone_has_the_standard_deviation_that_its_docstring_says() -> None:
    model = tone(3.0, 0.5, 0.7).to_model(0.02, 1.0)
    P = solve_discrete_lyapunov(model.F, model.process_covariance)
    np.testing.assert_allclose(P, 0.7 / (2 * np.pi * 0.5) * np.eye(2), rtol=1e-9, atol=1e-12)


def test_gauss_markov_noise_has_its_standard_deviation_and_forgets_in_its_time() -> None:
    model = gauss_markov(4.0, 0.3).to_model(0.5, 1.0)
    assert model.F.item() == pytest.approx(np.exp(-0.125), rel=1e-12)
    assert model.process_covariance.item() / (1 - model.F.item() ** 2) == pytest.approx(0.09, rel=1e-12)


def test_hum_is_a_disturbance_of_several_tones() -> None:
    noise = hum(60.0, 3, 1e-6)
    assert [part.name for part in noise.parts] == [f"oscillator at {f} Hz" for f in (60, 120, 180)]
    assert all(part.disturbance for part in noise.parts)
    assert not noise.signal_output.any()
    F = noise.over(np.array([1 / 60]))[0]
    np.testing.assert_allclose(F[0], np.eye(6), atol=1e-10)  # each returns after a period of the mains


def test_the_output_is_split_by_component() -> None:
    both = motion(2, 0.3) + tone(5.0) + bias(1e-3)
    assert [part.name for part, _ in both.outputs()] == ["motion", "oscillator at 5 Hz", "bias"]
    np.testing.assert_array_equal(sum(row for _, row in both.outputs()), both.output)
    np.testing.assert_array_equal(both.signal_output, [[1, 0, 1, 0, 0]])
    np.testing.assert_array_equal(both.as_disturbance().signal_output, np.zeros((1, 5)))


def test_noise_of_very_different_densities_keeps_its_digits() -> None:
    """A tone of density 1 beside one of density 1e-30: each is discretised as if it were alone."""
    Q = (tone(1.0, 0.1, 1.0) + tone(2.0, 0.1, 1e-30)).over(np.array([0.01]))[1][0]
    np.testing.assert_allclose(
        Q[2:, 2:], tone(2.0, 0.1, 1.0).over(np.array([0.01]))[1][0] * 1e-30, rtol=1e-12, atol=1e-46
    )


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: tone(0.0), "frequency_hz = 0.0"),
        (lambda: tone(np.nan), "frequency_hz = nan"),
        (lambda: tone(1.0, -1.0), "bandwidth_hz = -1.0"),
        (lambda: tone(1.0, 0.0, np.inf), "noise_density = inf"),
        (lambda: hum(50.0, 0), "harmonics = 0"),
        (lambda: gauss_markov(0.0), "correlation_s = 0.0"),
        (lambda: gauss_markov(1.0, -0.1), "std = -0.1"),
        (lambda: bias(-1.0), "noise_density = -1.0"),
        (lambda: motion(1, "1"), "noise_density = '1' is not a density; give a positive number or 0"),  # type: ignore[arg-type]
        (lambda: motion(1, True), "noise_density = True is not a density"),
        (lambda: motion(1, [1.0]), "noise_density = .* is not a density"),  # type: ignore[arg-type]
        (lambda: tone("50"), "frequency_hz = '50' is not a frequency"),  # type: ignore[arg-type]
        (lambda: tone(1e308), "leave the range of float64"),
        (lambda: hum(None), "mains_hz = None is not a frequency"),  # type: ignore[arg-type]
        (lambda: hum(50, 2.5), "harmonics = 2.5 is not a number of tones"),  # type: ignore[arg-type]
        (lambda: hum(50, True), "harmonics = True is not a number of tones"),
        (lambda: gauss_markov(1.0, 1e200), "Gauss-Markov noise leave the range of float64"),
        (lambda: gauss_markov(1e-320), "Gauss-Markov noise leave the range of float64"),
        (lambda: gauss_markov(1.0, None), "std = None"),  # type: ignore[arg-type]
        (lambda: level(10**400), "noise_density = 1000"),
        (lambda: level().to_model("1", 1.0), "step_s = '1' is not a step"),  # type: ignore[arg-type]
    ],
)
def test_impossible_numbers_are_refused(make: Any, says: str) -> None:
    with pytest.raises(ModelError, match=says):
        make()


def test_numbers_of_any_kind_are_numbers() -> None:
    expected = motion(2, 3.0).noise_density
    for order, density in ((np.int64(2), np.float32(3.0)), (2, np.array(3)), (2, 3)):
        np.testing.assert_array_equal(motion(order, density).noise_density, expected)  # type: ignore[arg-type]


def test_what_fades_has_gone_over_a_long_step() -> None:
    """Gauss-Markov noise and a damped tone have their own variance after any time, and none before it counts."""
    F, Q = (gauss_markov(1e-5, 2.0) + tone(7.3, 3e4, 0.7)).over(np.array([0.01, 1e3, 1e9]))
    assert np.abs(F).max() < 1e-100
    expected = np.diag([4.0, *[0.7 / (2 * np.pi * 3e4)] * 2])
    for one in Q:
        np.testing.assert_allclose(one, expected, rtol=1e-9, atol=1e-20)
