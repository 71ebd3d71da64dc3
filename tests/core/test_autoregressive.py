"""Coloured noise: Yule and Walker, Gauss and Markov, any whole number of steps, and one joint Gaussian."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov, toeplitz

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import DEFAULT_RESULTS
from becalm.core.filter.smoothing import run_smoother
from becalm.core.model.autoregressive import (
    ColouredNoise,
    autoregressive,
    from_partial_autocorrelations,
    partial_autocorrelations,
)
from becalm.core.model.components import gauss_markov, level, motion
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.errors import ModelError

NOISES = {"AR(1)": (0.9,), "AR(2)": (1.6, -0.9), "AR(3)": (0.5, 0.2, -0.3), "alternating": (-0.7,), "slow": (0.99999,)}
RESONANT = (1.2, -0.7, 0.1)


def autocovariances(coefficients: tuple[float, ...], count: int) -> Floats:
    """Solve the equations of Yule and Walker for a variance of 1, without any state."""
    p = len(coefficients)
    A, b = np.eye(p + 1), np.zeros(p + 1)
    for k in range(p + 1):
        for i, phi in enumerate(coefficients, start=1):
            A[k, abs(k - i)] -= phi
    b[0] = 1.0
    gamma = np.linalg.solve(A, b).tolist()
    for k in range(p + 1, count):
        gamma.append(sum(phi * gamma[k - i] for i, phi in enumerate(coefficients, start=1)))
    return np.asarray(gamma[:count], dtype=np.float64) / float(gamma[0])


@pytest.fixture(params=list(NOISES.values()), ids=list(NOISES))
def coefficients(request: pytest.FixtureRequest) -> tuple[float, ...]:
    found: tuple[float, ...] = request.param
    return found


def test_the_autocovariances_are_those_of_yule_and_walker(coefficients: tuple[float, ...]) -> None:
    F, Q = autoregressive(coefficients, 0.3).over(np.arange(12.0))
    P = solve_discrete_lyapunov(F[1], Q[1])
    expected = 0.09 * autocovariances(coefficients, 12)
    np.testing.assert_allclose([(step @ P)[0, 0] for step in F], expected, rtol=1e-8, atol=1e-10)


def test_many_steps_are_as_many_single_ones(coefficients: tuple[float, ...]) -> None:
    component = autoregressive(coefficients, 2.0, step_s=0.01)
    F, Q = component.over(0.01 * np.array([0, 1, 2, 3, 7, 100]))
    assert np.array_equal(F[0], np.eye(len(coefficients)))
    assert not Q[0].any()
    gathered, power = np.zeros_like(Q[0]), np.eye(len(coefficients))
    for k in range(1, 101):
        gathered, power = F[1] @ gathered @ F[1].T + Q[1], F[1] @ power
        if k in (2, 3, 7, 100):
            at = [0, 1, 2, 3, 7, 100].index(k)
            np.testing.assert_allclose(F[at], power, rtol=1e-11, atol=1e-14)
            np.testing.assert_allclose(Q[at], gathered, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("correlation_s", [1e-2, 1.0, 1e6])
def test_of_order_one_it_is_gauss_markov_noise(correlation_s: float) -> None:
    steps = 0.5 * np.array([1.0, 2.0, 5.0])
    F, Q = autoregressive((np.exp(-0.5 / correlation_s),), 0.3, step_s=0.5).over(steps)
    expected = gauss_markov(correlation_s, 0.3).over(steps)
    np.testing.assert_allclose(F, expected[0], rtol=1e-12)
    np.testing.assert_allclose(Q, expected[1], rtol=1e-9)  # 1 - phi^2 of a phi that is rounded: eps * 1e6 of it


def test_after_a_long_time_it_is_itself_again(coefficients: tuple[float, ...]) -> None:
    F, Q = autoregressive(coefficients, 3.0).over(np.array([1e9]))
    assert np.abs(F).max() < 1e-100
    rho = autocovariances(coefficients, len(coefficients))
    np.testing.assert_allclose(Q[0], 9 * toeplitz(rho), rtol=1e-9, atol=1e-9)


def test_partial_autocorrelations_there_and_back(coefficients: tuple[float, ...]) -> None:
    partial = partial_autocorrelations(coefficients)
    np.testing.assert_allclose(from_partial_autocorrelations(partial), coefficients, rtol=1e-9)
    assert max(abs(kappa) for kappa in partial) < 1


def test_the_innovation_variance_is_what_the_filter_cannot_foretell() -> None:
    noise = ColouredNoise((1.6, -0.9), 4.0)
    Q = autoregressive(noise.coefficients, 2.0).over(np.ones(1))[1]
    assert noise.innovation_variance == pytest.approx(Q[0, 0, 0], rel=1e-12)
    assert noise.innovation_variance == pytest.approx(4.0 * (1 - 0.9**2) * (1 - (1.6 / 1.9) ** 2), rel=1e-12)


def test_a_walk_in_coloured_noise_is_smoothed_as_one_joint_gaussian() -> None:
    """With its covariances written down, missing readings left out, and nothing known of the level."""
    rng, rows = np.random.default_rng(5), 60
    component = level(0.02) + autoregressive(RESONANT, 0.8)
    rho = autocovariances(RESONANT, rows)
    walk = 0.02 * np.minimum.outer(np.arange(rows), np.arange(rows))
    noise = 0.64 * toeplitz(rho)
    z = rng.multivariate_normal(np.zeros(rows), walk + noise + 0.1 * np.eye(rows)) + 7.0
    seen = np.delete(np.arange(rows), [10, 11, 12, 30, 40, 41])
    S = (walk + noise + 0.1 * np.eye(rows))[np.ix_(seen, seen)]
    one = np.ones(len(seen))
    start = one @ np.linalg.solve(S, z[seen]) / (one @ np.linalg.solve(S, one))
    expected = start + walk[:, seen] @ np.linalg.solve(S, z[seen] - start)

    P0 = np.diag([1e8, 0.0, 0.0, 0.0])  # a level of which next to nothing is known, noise as it has always been
    P0[1:, 1:] = 0.64 * toeplitz(rho[:3])
    plain = component.to_model(1.0, 0.1)
    model = Model(F=plain.F, H=plain.H, Q=plain.Q, R=plain.R, x0=[7.0, 0, 0, 0], P0=P0)
    elapsed = np.diff(seen, prepend=0).astype(float)
    line = elapsed_timeline(component, 0.1, elapsed)
    states = run_smoother(model, line, z[seen, np.newaxis], DEFAULT_RESULTS._replace(states=True))
    assert states.mean is not None
    np.testing.assert_allclose(states.mean[:, 0], expected[seen], rtol=1e-6)
    e = noise[np.ix_(seen, seen)] @ np.linalg.solve(S, z[seen] - start)
    np.testing.assert_allclose(states.mean[:, 1], e, atol=1e-6)


def test_beside_a_motion_it_is_a_disturbance_and_keeps_no_level() -> None:
    noise = autoregressive((0.5, 0.2))
    both = motion(2, 0.3) + noise
    assert [part.name for part in both.parts] == ["motion", "coloured noise"]
    assert both.state_names == ("level", "velocity", "noise", "noise 1 step before")
    np.testing.assert_array_equal(both.signal_output, [[1, 0, 0, 0]])
    np.testing.assert_array_equal(both.output, [[1, 0, 1, 0]])
    assert both.keeps_level
    assert not noise.keeps_level


def test_zeros_at_the_end_are_left_out() -> None:
    np.testing.assert_array_equal(autoregressive((0.5, 0.0)).over(np.ones(1))[0], [[[0.5]]])


def test_lengths_are_whole_up_to_rounding() -> None:
    component = autoregressive((0.9,), step_s=0.1)
    F, _ = component.over(np.array([0.1 + 0.2, 1e6 * 0.1]))
    assert F[0, 0, 0] == pytest.approx(0.9**3, rel=1e-12)
    for wrong in (0.05, 0.1 * (3 + 1e-6), -0.1, np.inf, np.nan, 1e300):
        with pytest.raises(
            ModelError, match=r"not a whole number of steps\. Give readings in even time, or use gauss_markov"
        ):
            component.over(np.array([wrong]))


def test_the_euler_form_is_refused() -> None:
    with pytest.raises(ModelError, match="no Euler form of coloured noise"):
        (motion(1) + autoregressive((0.9,))).to_model(1.0, 1.0, discretisation="euler")


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (((),), r"have no value but 0"),
        (((0.0, 0.0),), r"have no value but 0"),
        (((1.0,),), r"are not stationary"),
        (((0.5, 0.5),), r"are not stationary"),
        (((-1.1,),), r"are not stationary"),
        (((2.1, -1.2, 0.3, 0.4),), r"are not stationary"),
        (((np.nan,),), r"finite numbers"),
        (((0.5, np.inf),), r"finite numbers"),
        ((0.9,), r"finite numbers"),
        ((((0.5,), (0.2,)),), r"finite numbers"),
        ((("0.5",),), r"not numbers"),
        ((((0.5,), (0.2, 0.1)),), r"not numbers"),
        ((None,), r"finite numbers|not numbers"),
        (((0.9,), -1.0), r"^std = -1.0"),
        (((0.9,), 0.0), r"^std = 0.0"),
        (((0.9,), 1e200), r"^std = 1e\+200 leaves the range"),
        (((0.9,), "1"), r"^std = '1'"),
        (((0.9,), 1.0, 0.0), r"^step_s = 0.0"),
    ],
)
def test_what_is_no_noise_is_refused(given: Any, says: str) -> None:
    with pytest.raises(ModelError, match=says):
        autoregressive(*given)
