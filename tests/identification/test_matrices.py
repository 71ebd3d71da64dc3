"""Free covariances stay covariances, and what second moments tell of them is told rightly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.filter.likelihood import log_likelihood
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.errors import ModelError
from becalm.identification.several.autocovariances import Autocovariances, autocovariances
from becalm.identification.several.matrices import Freedom, FreeMatrix, patterns_of

START = np.array([[2.0, -0.5, 0.0], [-0.5, 1.0, 0.1], [0.0, 0.1, 4e-6]])
FREEDOMS: tuple[Freedom, ...] = ("full", "diagonal", "scale", "fixed")


def free(freedom: Freedom) -> FreeMatrix:
    start = START if freedom != "full" else START + 0.1 * np.eye(3)
    return FreeMatrix(patterns_of("Q", start, freedom), start, freedom == "full")


@given(numbers=st.lists(st.floats(-5, 5), min_size=6, max_size=6))
@settings(max_examples=50)
def test_any_numbers_give_a_positive_definite_matrix(numbers: list[float]) -> None:
    matrix = free("full")
    found = matrix.at(np.array(numbers))
    assert np.array_equal(found, found.T)
    scale = np.sqrt(np.diag(found))
    np.linalg.cholesky(found / np.outer(scale, scale) + 1e-12 * np.eye(3))


@pytest.mark.parametrize("freedom", ["full", "scale", "fixed"])
def test_at_zero_it_is_where_it_starts(freedom: Freedom) -> None:
    matrix = free(freedom)
    np.testing.assert_allclose(matrix.at(np.zeros(matrix.count)), matrix.start, rtol=1e-14)


@pytest.mark.parametrize("freedom", FREEDOMS)
def test_slopes_are_those_of_differences(freedom: Freedom) -> None:
    matrix = free(freedom)
    theta = np.random.default_rng(1).normal(size=matrix.count)
    slopes = matrix.slopes(theta)
    assert slopes.shape == (matrix.count, 3, 3)
    for step, slope in zip(1e-5 * np.eye(matrix.count), slopes, strict=True):
        difference = (matrix.at(theta + step) - matrix.at(theta - step)) / 2e-5
        np.testing.assert_allclose(slope, difference, rtol=1e-8, atol=1e-9)


def test_patterns_are_named_and_add_up() -> None:
    full = patterns_of("R", START, "full")
    assert full.names == ("R[0,0]", "R[0,1]", "R[1,1]", "R[0,2]", "R[1,2]", "R[2,2]")
    assert full.variances.tolist() == [True, False, True, False, False, True]
    np.testing.assert_array_equal(full.covariance(full.amounts(START)), START)
    diagonal = patterns_of("Q", START, "diagonal")
    np.testing.assert_array_equal(diagonal.covariance(diagonal.amounts(START)), np.diag(np.diag(START)))


def test_each_component_has_one_scale() -> None:
    joined = (motion(1, 2.0) + motion(3, 0.1)).to_model(1.0, 1.0)
    scales = patterns_of("Q", joined.process_covariance, "scale")
    assert scales.names == ("the scale of Q[0]", "the scale of Q[1:4]")
    np.testing.assert_allclose(scales.covariance(np.ones(2)), joined.process_covariance)
    apart = np.array([[1.0, 0, 0.5], [0, 0, 0], [0.5, 0, 1.0]])
    assert patterns_of("R", apart, "scale").names == ("the scale of R[0,2]",)


def test_a_freedom_that_is_not_known_is_refused() -> None:
    with pytest.raises(ModelError, match="'most' is not a choice of free entries of R; use one of"):
        patterns_of("R", START, "most")  # type: ignore[arg-type]


def told(model: Model, free_process: Freedom, free_noise: Freedom = "diagonal") -> Autocovariances:
    together = np.ones((model.channels, model.channels), dtype=bool)
    process, noise = patterns_of("Q", model.Q, free_process), patterns_of("R", model.R, free_noise)
    return autocovariances(model, process, noise, together, np.ones(model.channels))


def stacked_covariance(model: Model, start: Floats, rows: int) -> Floats:
    """Return the covariance of successive readings, one pair of rows after the other."""
    m, P, found = model.channels, start, np.zeros((rows * model.channels, rows * model.channels))
    for i in range(rows):
        ahead = P
        for j in range(i, rows):
            block = model.H @ ahead @ model.H.T + (model.R if i == j else 0.0)
            found[j * m : (j + 1) * m, i * m : (i + 1) * m] = block
            found[i * m : (i + 1) * m, j * m : (j + 1) * m] = block.T
            ahead = model.F @ ahead
        P = model.F @ P @ model.F.T + model.process_covariance
    return found


@pytest.mark.parametrize("growth", [0.5, 1.0, 1.3])
def test_the_map_gives_the_covariance_of_what_no_state_touches(growth: float) -> None:
    """Whatever the state before, and whether or not it grows."""
    rng = np.random.default_rng(3)
    A, B, C = rng.normal(size=(3, 3)), rng.normal(size=(2, 2)), rng.normal(size=(2, 2))
    F = growth * np.linalg.qr(A)[0]
    model = Model(F=F, G=rng.normal(size=(3, 2)), H=rng.normal(size=(2, 3)), Q=B @ B.T, R=C @ C.T)
    found = told(model, "full", "full")
    start = A @ A.T
    T = found.noise_only
    amounts = np.concatenate(
        [patterns_of("Q", model.Q, "full").amounts(model.Q), patterns_of("R", model.R, "full").amounts(model.R)]
    )
    exact = T.T @ stacked_covariance(model, start, found.rows) @ T
    np.testing.assert_allclose((found.slopes @ amounts).reshape(exact.shape), exact, atol=1e-9)
    half = told(model, "fixed", "full")
    np.testing.assert_allclose(half.slopes @ amounts[3:] + half.fixed, found.slopes @ amounts, atol=1e-9)


LEVEL, SLOPE, CURVE = (motion(order).to_model(1.0, 1.0) for order in (1, 2, 3))
PLANE = Model(F=[[0.9, 0], [-0.3, 0.8]], H=np.eye(2), Q=np.eye(2), R=np.eye(2))


@pytest.mark.parametrize(
    ("model", "freedom", "rank", "unknowns"),
    [
        (LEVEL, "full", 2, 2),
        (SLOPE, "diagonal", 3, 3),
        (SLOPE, "full", 3, 4),
        (CURVE, "full", 4, 7),
        (PLANE, "full", 5, 5),
        (motion(5).to_model(1 / 500, 1.0), "scale", 2, 2),
        (Model(F=[[0.0]], H=[[1.0]], Q=[[1.0]], R=[[1.0]]), "full", 1, 2),
    ],
)
def test_as_many_unknowns_are_told_as_there_are_moments(
    model: Model, freedom: Freedom, rank: int, unknowns: int
) -> None:
    """An n-th difference of n-th order motion has n + 1 autocovariances, and no more."""
    found = told(model, freedom)
    assert (found.rank, found.slopes.shape[1]) == (rank, unknowns)
    assert found.undetermined_amounts().shape == (unknowns, unknowns - rank)
    assert len(found.confounded) + found.unseen.sum() == unknowns - rank
    np.testing.assert_allclose(found.slopes @ found.undetermined_amounts(), 0.0, atol=1e-9 * np.abs(found.slopes).max())


def test_along_what_is_not_told_no_likelihood_changes() -> None:
    """Exactly, once the first rows are forgotten; along any other direction it does."""
    Q, R = np.array([[0.3, 0.05], [0.05, 0.2]]), np.array([[2.0]])
    slope = Model(F=SLOPE.F, H=SLOPE.H, Q=Q, R=R)
    found = told(slope, "full")
    direction = found.undetermined_amounts()[:, 0]
    process = patterns_of("Q", Q, "full")
    assert direction[-1] == 0.0
    rng = np.random.default_rng(4)
    z = np.cumsum(np.cumsum(rng.normal(size=4000))) + rng.normal(size=4000)

    def gain(step: Floats) -> float:
        """Return by how much rows 2000 and later become likelier."""
        moved = Model(F=SLOPE.F, H=SLOPE.H, Q=Q + process.covariance(step), R=R)
        now, then = (log_likelihood(model, z) - log_likelihood(model, z[:2000]) for model in (moved, slope))
        return now - then

    assert gain(0.02 * direction[:-1]) == pytest.approx(0.0, abs=1e-6)
    assert abs(gain(0.02 * np.eye(3)[2])) > 1.0


def test_moments_point_to_the_truth() -> None:
    rng = np.random.default_rng(5)
    x, z = np.zeros(2), np.empty((50_000, 2))
    for k, (w, v) in enumerate(zip(rng.normal(size=z.shape), rng.normal(size=z.shape), strict=True)):
        z[k] = x + np.sqrt([3.0, 2.0]) * v
        x = PLANE.F @ x + np.sqrt([2.0, 1.0]) * w
    amounts = told(PLANE, "full", "full").estimate(z)
    assert amounts is not None
    np.testing.assert_allclose(amounts, [2.0, 0.0, 1.0, 3.0, 0.0, 2.0], atol=0.15)
    z[::4] = np.nan
    assert told(PLANE, "full", "full").estimate(z) is None
    assert told(PLANE, "full", "full").estimate(z[:3]) is None
