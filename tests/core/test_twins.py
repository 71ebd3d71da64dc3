"""Twins: the kernels say what `core.reference` says, to 1e-12 of each quantity's size."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from against_reference import assert_filter, assert_smoother, assert_twins, known
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.model import Model

ROWS = 300
DAMPED = 0.9 * (np.eye(4) + np.eye(4, k=1) * 0.1 + np.eye(4, k=2) * 0.005)
ROTATION = [[0.95, -0.3, 0.0], [0.3, 0.95, 0.0], [0.02, 0.01, 0.9]]
CORRELATED = [[1.0, 0.6, -0.3], [0.6, 2.0, 0.4], [-0.3, 0.4, 0.5]]


class Case(NamedTuple):
    """A model with x0 and P0, and which of its readings do not arrive."""

    matrices: dict[str, Any]
    missing: str = "none"


def start(n: int, spread: float = 4.0) -> dict[str, Any]:
    return {"x0": np.arange(1.0, n + 1), "P0": spread * np.eye(n)}


LEVEL: dict[str, Any] = {"F": [[1.0]], "H": [[1.0]], "Q": [[0.03]], "R": [[0.7]], **start(1)}
SLOPE: dict[str, Any] = {
    "F": [[1, 0.1], [0, 1]],
    "H": [[1, 0]],
    "Q": [[0.01, 0], [0, 0.1]],
    "R": [[2]],
    **start(2),
}
THREE: dict[str, Any] = {"F": ROTATION, "H": np.eye(3), "Q": 0.05 * np.eye(3), "R": CORRELATED, **start(3)}
FOUR: dict[str, Any] = {
    "F": DAMPED,
    "H": [[1, 0, 0, 0], [0.5, 1, 0, 0.2]],
    "G": [[0, 0], [0, 0], [1, 0], [0, 1]],
    "Q": [[0.2, 0.1], [0.1, 0.3]],
    "R": [[1.0, -0.4], [-0.4, 0.9]],
    **start(4),
}
DEAD: dict[str, Any] = {"F": np.eye(2), "H": np.eye(2), **{k: np.diag([0.0, 1.0]) for k in ("Q", "R", "P0")}}
DEAD = DEAD | {"x0": [3.0, 1.0]}
WIDE: dict[str, Any] = {"F": [[0.99]], "H": [[1], [2], [-1]], "Q": [[0.1]], "R": CORRELATED, **start(1)}

CASES = {
    "level": Case(LEVEL),
    "level, gaps": Case(LEVEL, "runs"),
    "level, R = 0": Case(LEVEL | {"R": [[0.0]]}),
    "level, Q = 0": Case(LEVEL | {"Q": [[0.0]]}),
    "level, P0 = 0": Case(LEVEL | {"P0": [[0.0]]}),
    "slope": Case(SLOPE),
    "slope, gaps": Case(SLOPE, "runs"),
    "slope, Inf among the readings": Case(SLOPE, "infinite"),
    "slope, P0 of ones": Case(SLOPE | {"P0": np.ones((2, 2))}, "runs"),
    "slope, Q = 0": Case(SLOPE | {"Q": np.zeros((2, 2))}),
    "slope, Q of rank one by G": Case(SLOPE | {"G": [[0.005], [0.1]], "Q": [[3.0]]}),
    "three states, three channels": Case(THREE),
    "three states, channels missing one by one": Case(THREE, "scattered"),
    "three states, first rows missing": Case(THREE, "head"),
    "three states, R = 0": Case(THREE | {"R": np.zeros((3, 3))}),
    "three states, R of rank one": Case(THREE | {"R": np.ones((3, 3))}, "scattered"),
    "two states, one of them and its channel dead": Case(DEAD, "runs"),
    "four states, two channels, G": Case(FOUR),
    "four states, two channels, scattered": Case(FOUR, "scattered"),
    "four states, two channels, runs": Case(FOUR, "runs"),
    "one state, three channels": Case(WIDE, "scattered"),
    "nothing arrives": Case(FOUR, "all"),
}


def simulate(model: Model, missing: str, rows: int = ROWS) -> Floats:
    """Draw readings (rows, m) that the model describes, and take some of them away."""
    rng = np.random.default_rng(20)
    assert model.x0 is not None
    v = rng.multivariate_normal(np.zeros(model.channels), model.R, size=rows)
    w = rng.multivariate_normal(np.zeros(model.states), model.process_covariance, size=rows)
    x, z = model.x0, np.empty((rows, model.channels))
    for k in range(rows):
        z[k] = model.H @ x + v[k]
        x = model.F @ x + w[k]
    if missing == "scattered":
        z[rng.random(z.shape) < 0.3] = np.nan
    elif missing == "infinite":
        z[5::17], z[6::19] = np.inf, -np.inf
    elif missing == "head":
        z[:7], z[7, 1:] = np.nan, np.nan
    elif missing == "runs":
        z[40:44], z[120:190], z[260:] = np.nan, np.nan, np.nan
    elif missing == "all":
        z[:] = np.nan
    return z


@pytest.fixture(params=list(CASES.values()), ids=list(CASES))
def case(request: pytest.FixtureRequest) -> tuple[Model, Floats]:
    found: Case = request.param
    model = Model(**found.matrices)
    return model, simulate(model, found.missing)


def test_the_filter_is_its_twin(case: tuple[Model, Floats]) -> None:
    model, z = case
    about = known(model, z, smooth=False)
    for covariances in (False, True):
        assert_filter(kalman_filter(model, z, states=True, covariances=covariances), about)


def test_a_reading_that_can_teach_nothing_does_not_enter_the_likelihood() -> None:
    model = Model(F=[[1]], H=[[1]], Q=[[0]], R=[[0]], x0=[2], P0=[[0]])
    got = kalman_filter(model, [2.0, 2.0, 2.0])
    assert got.used == 0
    assert got.log_likelihood == 0.0
    assert np.array_equal(got.signal, [[2.0]] * 3)


def test_the_smoother_is_its_twin(case: tuple[Model, Floats]) -> None:
    model, z = case
    about = known(model, z)
    for covariances in (False, True):
        assert_smoother(kalman_smoother(model, z, states=True, covariances=covariances), about)


SETTLING: dict[str, dict[str, Any]] = {
    "level": LEVEL,
    "slope": SLOPE,
    "three states, three channels": THREE,
    "four states, two channels, G": FOUR,
    "one state, three channels": WIDE,
    "slope, slow": SLOPE | {"Q": [[0, 0], [0, 1e-6]]},
}


@pytest.mark.parametrize("name", SETTLING)
def test_a_settled_gain_gives_what_the_full_recursion_gives(name: str) -> None:
    model = Model(**SETTLING[name])
    z = simulate(model, "none", rows=4000)
    got = kalman_filter(model, z, states=True, covariances=True)
    assert got.cov is not None
    assert np.array_equal(got.cov[-1], got.cov[-2]), "the gain never settled, so nothing was tested"
    assert_filter(got, known(model, z, smooth=False))


@pytest.mark.parametrize("name", SETTLING)
def test_a_gap_wakes_a_settled_gain(name: str) -> None:
    model = Model(**SETTLING[name])
    z = simulate(model, "none", rows=4000)
    z[1500:1530] = np.nan
    z[1700, 0] = np.nan
    z[2500, -1] = np.inf
    about = known(model, z)
    assert_filter(kalman_filter(model, z, states=True, covariances=True), about)
    assert_smoother(kalman_smoother(model, z, states=True), about)


def test_settling_is_noticed_at_all() -> None:
    model = Model(**LEVEL)
    cov = kalman_filter(model, simulate(model, "none", rows=1000), covariances=True).cov
    assert cov is not None
    assert np.array_equal(cov[300:], np.broadcast_to(cov[300], cov[300:].shape))


def test_an_unobserved_unstable_state_leaves_the_observed_one_alone() -> None:
    model = Model(F=[[1.5, 0.0], [0.0, 1.0]], H=[[0, 1]], Q=np.eye(2), R=[[1]], x0=[1, 0], P0=np.eye(2))
    alone = Model(F=[[1]], H=[[1]], Q=[[1]], R=[[1]], x0=[0], P0=[[1]])
    z = np.random.default_rng(1).normal(size=5000)
    both, one = kalman_filter(model, z, states=True, covariances=True), kalman_filter(alone, z)
    assert both.cov is not None
    assert np.isfinite(both.cov).all()
    assert both.cov[-1, 0, 0] > 1e199, "its variance stopped growing before it had to"
    assert_twins(both.signal, one.signal)
    assert_twins(both.sigma, one.sigma)
