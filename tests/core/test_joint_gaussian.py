"""Oracle: the whole record as one least-squares problem, with no recursion at all.

Every state is written by the first one and the noises, x_k = F^k x_1 + sum F^(k-1-j) w_j. Whitened
readings, whitened noises and, where given, the whitened prior are the rows of A theta = b, solved
by QR; a flat start simply has no prior rows. It is the same problem, solved on another road.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.model import Model

ROWS = 24
ORACLE = 1e-9


def square_root(covariance: Floats) -> Floats:
    """Return L (n, r) with L L' = covariance, r its rank."""
    values, vectors = np.linalg.eigh(covariance)
    live = values > 1e-12 * max(values.max(initial=0.0), 1e-300)
    root: Floats = vectors[:, live] * np.sqrt(values[live])
    return root


class Answer(NamedTuple):
    mean: Floats
    cov: Floats
    cost: float  # b' b of what theta cannot reach
    log_det: float  # of A' A
    complete: bool


@dataclass
class Joint:
    """The record as one linear Gaussian problem in theta = (x_1 or its whitened error, whitened noises)."""

    model: Model
    z: Floats

    def __post_init__(self) -> None:
        model, count = self.model, len(self.z)
        root = square_root(model.process_covariance)
        flat = model.P0 is None
        first = np.eye(model.states) if model.P0 is None else square_root(model.P0)
        width = first.shape[1] + (count - 1) * root.shape[1]
        self.noises = width - (first.shape[1] if flat else 0)
        self.offset = np.zeros((count, model.states))
        if model.x0 is not None:
            self.offset[0] = model.x0
        self.states = np.zeros((count, model.states, width))
        self.states[0, :, : first.shape[1]] = first
        for k in range(1, count):
            self.states[k] = model.F @ self.states[k - 1]
            self.offset[k] = model.F @ self.offset[k - 1]
            at = first.shape[1] + (k - 1) * root.shape[1]
            self.states[k, :, at : at + root.shape[1]] += root
        self.prior = np.eye(width)[width - self.noises :]

    def solve(self, upto: int) -> Answer:
        """Condition on the readings of the first `upto` rows; mean (N, n) and cov (N, n, n) of every row's state."""
        rows, right, log_det = [self.prior], [np.zeros(self.noises)], 0.0
        for k in range(upto):
            seen = np.isfinite(self.z[k])
            if not seen.any():
                continue
            lower = np.linalg.cholesky(self.model.R[np.ix_(seen, seen)])
            H = self.model.H[seen]
            rows.append(np.linalg.solve(lower, H @ self.states[k]))
            right.append(np.linalg.solve(lower, self.z[k, seen] - H @ self.offset[k]))
            log_det += 2 * np.log(np.diag(lower)).sum()
        A, b = np.vstack(rows), np.concatenate(right)
        U, singular, V = np.linalg.svd(A, full_matrices=False)
        complete = len(A) >= A.shape[1] and bool(singular[-1] > 1e-11 * singular[0])
        if not complete:
            nothing = np.full(self.offset.shape, np.nan)
            return Answer(nothing, self.states[:, :, :0], np.nan, np.nan, False)
        theta = V.T @ (U.T @ b / singular)
        spread = self.states @ (V.T / singular)
        cost = float(np.sum((b - A @ theta) ** 2))
        mean = self.offset + self.states @ theta
        return Answer(mean, spread @ np.swapaxes(spread, 1, 2), cost, log_det + 2 * float(np.log(singular).sum()), True)


FREE: dict[str, dict[str, Any]] = {
    "level": {"F": [[1]], "H": [[1]], "Q": [[0.2]], "R": [[0.7]]},
    "slope, Q of rank one": {"F": [[1, 1], [0, 1]], "H": [[1, 0]], "G": [[0.5], [1]], "Q": [[0.05]], "R": [[1]]},
    "slope, stiff": {"F": [[1, 1], [0, 1]], "H": [[1, 0]], "Q": [[0, 0], [0, 1e-4]], "R": [[1]]},
    "slope, Q = 0": {"F": [[1, 1], [0, 1]], "H": [[1, 0]], "Q": np.zeros((2, 2)), "R": [[1]]},
    "acceleration": {
        "F": [[1, 1, 0.5], [0, 1, 1], [0, 0, 1]],
        "H": [[1, 0, 0]],
        "G": [[1 / 6], [0.5], [1]],
        "Q": [[0.1]],
        "R": [[1]],
    },
    "three channels, R correlated": {
        "F": [[1, 0.5, 0], [0, 0.9, 0.2], [0, -0.2, 0.9]],
        "H": [[1, 0, 0], [0.5, 1, 0], [0, 0, 1]],
        "Q": [[0.3, 0.1, 0], [0.1, 0.2, 0], [0, 0, 0.1]],
        "R": [[1.0, 0.6, -0.3], [0.6, 2.0, 0.4], [-0.3, 0.4, 0.5]],
    },
}
MISSING = ("none", "leading", "gaps", "scattered", "leading and gaps")


def holes(shape: tuple[int, int], missing: str) -> Floats:
    rng = np.random.default_rng(4)
    z = 3 * rng.normal(size=shape) + np.arange(shape[0])[:, np.newaxis]
    if "leading" in missing:
        z[:3] = np.nan
    if "gaps" in missing:
        z[4:6], z[12:17], z[22:] = np.nan, np.nan, np.nan
    if missing == "scattered":
        z[rng.random(shape) < 0.4] = np.nan
    return z


@pytest.fixture(params=MISSING)
def missing(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(params=["prior", "singular prior", "flat"])
def model(request: pytest.FixtureRequest, free: dict[str, Any]) -> Model:
    n = len(np.asarray(free["F"]))
    if request.param == "flat":
        return Model(**free)
    P0 = 9 * np.eye(n) if request.param == "prior" else np.ones((n, n))
    return Model(**free, x0=np.arange(1.0, n + 1), P0=P0)


@pytest.fixture(params=list(FREE.values()), ids=list(FREE))
def free(request: pytest.FixtureRequest) -> dict[str, Any]:
    found: dict[str, Any] = request.param
    return found


def assert_same(got: Floats, expected: Floats) -> None:
    """Agree to 1e-9 of each component's largest value over the record."""
    size = np.abs(expected).max(axis=0)
    assert (np.abs(got - expected) <= ORACLE * size).all()


def test_the_smoother_is_one_joint_gaussian(model: Model, missing: str) -> None:
    z = holes((ROWS, model.channels), missing)
    expected = Joint(model, z).solve(ROWS)
    got = kalman_smoother(model, z, states=True, covariances=True)
    assert expected.complete
    assert got.mean is not None
    assert got.cov is not None
    assert_same(got.mean, expected.mean)
    assert_same(got.cov, expected.cov)
    assert_same(got.signal, expected.mean @ model.H.T)
    assert_same(got.sigma**2, np.einsum("ai,kij,aj->ka", model.H, expected.cov, model.H))


def test_the_filter_is_one_joint_gaussian_a_row(model: Model, missing: str) -> None:
    z = holes((ROWS, model.channels), missing)
    joint = Joint(model, z)
    answers = [joint.solve(k + 1) for k in range(ROWS)]
    known = np.array([answer.complete for answer in answers])
    got = kalman_filter(model, z, states=True, covariances=True)
    assert known.any()
    assert got.mean is not None
    assert got.cov is not None
    assert np.array_equal(np.isfinite(got.mean).all(axis=1), known), "the state is told before or after it is known"
    assert_same(got.mean[known], np.array([a.mean[k] for k, a in enumerate(answers) if a.complete]))
    assert_same(got.cov[known], np.array([a.cov[k] for k, a in enumerate(answers) if a.complete]))


def test_the_likelihood_is_that_of_one_joint_gaussian(model: Model, missing: str) -> None:
    z = holes((ROWS, model.channels), missing)
    joint = Joint(model, z)
    whole = joint.solve(ROWS)
    expected, count, cost, log_det = 0.0, np.isfinite(z).sum(), whole.cost, whole.log_det
    if model.P0 is None:  # of the readings after the opening, given the opening
        rows = next(k for k in range(1, ROWS + 1) if joint.solve(k).complete)
        opening = joint.solve(rows)
        cost, log_det, count = cost - opening.cost, log_det - opening.log_det, np.isfinite(z[rows:]).sum()
    expected = -0.5 * (cost + log_det + count * np.log(2 * np.pi))
    got = kalman_filter(model, z)
    assert got.used == count
    assert got.log_likelihood == pytest.approx(expected, rel=ORACLE, abs=ORACLE)


def test_a_signal_is_told_as_soon_as_the_readings_tell_it(free: dict[str, Any], missing: str) -> None:
    """Before the whole state is known, H x is given where, and only where, the readings determine it."""
    model = Model(**free)
    z = holes((ROWS, model.channels), missing)
    got = kalman_filter(model, z)
    for k in range(6):
        joint = Joint(model, z[: k + 1])
        seen = [(j, c) for j in range(k + 1) for c in range(model.channels) if np.isfinite(z[j, c])]
        flat = np.array([model.H[c] @ np.linalg.matrix_power(model.F, j) for j, c in seen]).reshape(-1, model.states)
        target = model.H @ np.linalg.matrix_power(model.F, k)
        for channel in range(model.channels):
            told = np.linalg.matrix_rank(np.vstack([flat, target[channel]])) == np.linalg.matrix_rank(flat)
            assert np.isfinite(got.sigma[k, channel]) == told
            assert np.isfinite(got.signal[k, channel]) == told
        answer = joint.solve(k + 1)
        if answer.complete:
            np.testing.assert_allclose(got.signal[k], model.H @ answer.mean[k], rtol=ORACLE, atol=ORACLE)


def test_before_any_reading_nothing_is_claimed(free: dict[str, Any]) -> None:
    model = Model(**free)
    z = np.full((5, model.channels), np.nan)
    for run in (kalman_filter, kalman_smoother):
        got = run(model, z, states=True)
        assert np.isnan(got.signal).all()
        assert np.isinf(got.sigma).all()
        assert got.used == 0
        assert got.log_likelihood == 0.0
