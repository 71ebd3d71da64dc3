"""The filter in C of several channels: any cut gives the same bits, and arrays that do not fit are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import WantedResults, kalman_filter, new_buffers, new_kernel, rows_of
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import even_timeline
from becalm.errors import ModelError
from becalm.native.multivariate import EstimateBuffers, MeasurementRows, Multivariate

WANTED = WantedResults(states=True, covariances=True)
SIZES = [(1, 1), (2, 1), (2, 2), (3, 3), (2, 3), (4, 2), (6, 3), (8, 2)]


def model_of(n: int, m: int, start: str) -> Model:
    rng = np.random.default_rng(10 * n + m)
    F = 0.95 * np.linalg.qr(rng.normal(size=(n, n)))[0]
    A = rng.normal(size=(m, m))
    prior: dict[str, Any] = {"flat": {}, "known": {"P0": np.eye(n)}, "wide": {"P0": 1e12 * np.eye(n)}}[start]
    if prior:
        prior["x0"] = rng.normal(size=n)
    return Model(F, rng.normal(size=(m, n)), 0.1 * np.eye(n), A @ A.T + np.eye(m), **prior)


def record_of(model: Model, rows: int = 1000) -> Floats:
    z = np.random.default_rng(3).normal(size=(rows, model.channels))
    z[:2], z[300:310], z[40, 0], z[41, -1], z[700, 0] = np.nan, np.nan, np.inf, 1e300, np.nan
    return z


@pytest.mark.parametrize("start", ["flat", "known", "wide"])
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_any_cut_gives_the_same_bits(size: tuple[int, int], start: str) -> None:
    model = model_of(*size, start)
    z = record_of(model)
    whole, beliefs = (
        new_kernel(model, even_timeline(model, len(z)), WANTED),
        new_buffers(model, len(z), WANTED),
    )
    whole.filter(rows_of(even_timeline(model, len(z)), z), beliefs)
    assert whole.head["settled_row"] > 0
    for length in (11, 64, 333):
        cut = new_kernel(model, even_timeline(model, len(z)), WANTED)
        for first in range(0, len(z), length):
            part = z[first : first + length]
            found = new_buffers(model, len(part), WANTED)
            cut.filter(rows_of(even_timeline(model, len(part), continues=first > 0), part), found)
            for name, got in found._asdict().items():
                expected = getattr(beliefs, name)[first : first + length]
                assert np.array_equal(got, expected, equal_nan=True), name
            other = new_kernel(model, even_timeline(model, len(z)), WANTED)
            other.state[:] = cut.state  # its bytes are a checkpoint
            cut = other
        assert cut.state.tobytes() == whole.state.tobytes()


@pytest.mark.parametrize("run", [kalman_filter, kalman_smoother])
def test_a_model_that_is_too_large_is_refused(run: Any) -> None:
    many = Model(np.eye(2), np.ones((33, 2)), np.eye(2), np.eye(33))
    with pytest.raises(ModelError, match="2 states and 33 channels; up to 72 states and 32 channels"):
        run(many, np.zeros((3, 33)))
    with pytest.raises(ModelError, match="73 states"):
        run(Model(np.eye(73), np.ones((1, 73)), np.eye(73), 1.0), np.zeros(3))


@pytest.mark.parametrize("run", [kalman_filter, kalman_smoother])
def test_the_largest_model_runs(run: Any) -> None:
    rng = np.random.default_rng(0)
    model = Model(0.9 * np.eye(72), rng.normal(size=(32, 72)), np.eye(72), np.eye(32), x0=np.zeros(72), P0=np.eye(72))
    found = run(model, rng.normal(size=(5, 32)))
    assert np.isfinite(found.signal).all()
    assert (found.sigma > 0).all()


def given(**changes: Any) -> tuple[MeasurementRows, EstimateBuffers]:
    rows: dict[str, Any] = {
        "z": np.zeros((4, 2)),
        "first": np.array([0, 1, 4]),
        "step": np.array([-1, 0]),
        "F": np.eye(3)[np.newaxis].copy(),
        "Q": np.eye(3)[np.newaxis].copy(),
        "lengths": np.ones(1),
    }
    room: dict[str, Any] = {"signal": np.empty((4, 2)), "innovation": np.empty((4, 2)), "x": np.empty((4, 3))}
    for name, change in changes.items():
        (rows if name in rows else room)[name] = change
    return MeasurementRows(**rows), EstimateBuffers(**room)


UNFIT: dict[str, list[Any]] = {
    "z": [np.zeros((4, 3)), np.zeros((4, 2), np.float32), np.zeros((2, 4)).T, np.zeros((3, 2))],
    "first": [np.array([0, 1, 5]), np.array([1, 2, 4]), np.array([0, 3, 3]), np.array([0, 4]), np.array([0, 5, 4])],
    "step": [np.array([-2, 0]), np.array([0, 1]), np.array([0, 0], np.int32)],
    "F": [np.zeros((0, 3, 3)), np.eye(2)[np.newaxis], np.eye(3)],
    "Q": [np.zeros((2, 3, 3))],
    "lengths": [np.ones(2)],
    "signal": [np.empty((4, 3)), np.empty((5, 2)), np.broadcast_to(0.0, (4, 2))],
    "innovation": [np.empty(4)],
    "x": [np.empty((4, 2)), np.empty((3, 4)).T],
    "P": [np.empty((4, 3, 2))],
}


@pytest.mark.parametrize(("name", "array"), [(name, array) for name, arrays in UNFIT.items() for array in arrays])
def test_arrays_beyond_whose_ends_c_would_read_are_refused(name: str, array: Any) -> None:
    kernel = Multivariate(np.ones((2, 3)), np.eye(2), np.zeros((3, 3)), np.zeros(3))
    for run in (kernel.filter, kernel.smooth):
        with pytest.raises(ValueError, match=r"needed|in one piece|steps|cannot be written"):
            run(*given(**{name: array}))
        run(*given())


def test_parts_of_a_model_that_do_not_fit_are_refused() -> None:
    H, R, prior, right = np.ones((2, 3)), np.eye(2), np.zeros((3, 3)), np.zeros(3)
    for arrays in (
        (H, np.eye(3), prior, right),
        (H, R, prior[:2], right),
        (H, R, prior, right[:2]),
        (H.T, R, prior, right),
    ):
        with pytest.raises(ValueError, match="in one piece"):
            Multivariate(*arrays)
    with pytest.raises(ValueError, match="1 to 72"):
        Multivariate(np.ones((1, 73)), np.eye(1), np.zeros((73, 73)), np.zeros(73))
    with pytest.raises(ValueError, match="in one piece"):
        Multivariate(H, R, prior, right).start(np.zeros(2), np.eye(3))
    with pytest.raises(ValueError, match="innovations"):
        Multivariate(H, R, prior, right).smooth(given()[0], EstimateBuffers(signal=np.empty((4, 2))))
