"""A batch of records is each of them filtered alone."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.batch import filter_batch
from becalm.core.filter.filtering import kalman_filter
from becalm.core.model.model import Model
from becalm.errors import ModelError

T = 1e-4
SUMMED = 1e-13  # thousands of rows, added up in another order; 1.7e-15 is reached
MODELS = {
    "the IMU paper's form, Q / R = 1e6, never settles here": Model(
        F=np.array([[1, T], [0, 1]]), H=[[1, 0]], Q=np.eye(2), R=[[1e-6]], G=T * np.eye(2), x0=[0, 0], P0=np.eye(2)
    ),
    "flat start": Model(F=[[1, 1], [0, 1]], H=[[1, 0]], Q=0.1 * np.eye(2), R=[[1]]),
    "two channels": Model(F=[[1.0, 1.0], [0.0, 0.9]], H=[[1, 0], [1, 1]], Q=np.eye(2), R=[[1.0, 0.3], [0.3, 2.0]]),
    "wide prior": Model(F=[[1, 1], [0, 1]], H=[[1, 0]], Q=0.1 * np.eye(2), R=[[1]], x0=[0, 0], P0=1e12 * np.eye(2)),
    "never observed": Model(
        F=np.array([[1, T], [0, 1]]), H=[[0, 1]], Q=np.eye(2), R=[[1]], x0=[0, 0], P0=np.ones((2, 2))
    ),
}


def records(model: Model, count: int, rows: int) -> Floats:
    return np.random.default_rng(0).normal(size=(count, rows, model.channels))


def assert_each_alone(model: Model, z: Floats) -> None:
    batch = filter_batch(model, z, states=True)
    assert batch.mean is not None
    for at, one in enumerate(z):
        alone = kalman_filter(model, one, states=True)
        assert alone.mean is not None
        pairs = (
            (batch.signal[at], alone.signal),
            (batch.sigma[at], alone.sigma),
            (batch.innovations[at], alone.innovations),
            (batch.innovation_sigma[at], alone.innovation_sigma),
            (batch.mean[at], alone.mean),
        )
        for got, expected in pairs:
            assert got.shape == expected.shape
            size = np.abs(expected[np.isfinite(expected)]).max(initial=0.0)
            np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12 * size)
        assert batch.used[at] == alone.used
        assert batch.log_likelihood[at] == pytest.approx(alone.log_likelihood, rel=SUMMED)


@pytest.mark.parametrize("rows", [1, 2, 3, 255, 256, 259, 1500])
@pytest.mark.parametrize("name", MODELS)
def test_complete_records(name: str, rows: int) -> None:
    assert_each_alone(MODELS[name], records(MODELS[name], 9, rows))


@pytest.mark.parametrize("name", MODELS)
def test_records_in_which_readings_are_missing(name: str) -> None:
    model = MODELS[name]
    z = records(model, 11, 1300)
    z[1, 50], z[2, 1200, -1], z[3, 0], z[4, 300], z[5], z[6, -1] = np.nan, np.inf, np.nan, 1e120, np.nan, np.nan
    assert_each_alone(model, z)


def test_only_what_is_wanted() -> None:
    model = MODELS["two channels"]
    z = records(model, 3, 400)
    batch, full = filter_batch(model, z, innovations=False), filter_batch(model, z, states=True)
    assert batch.mean is None
    assert batch.innovations.shape == (3, 0, 2)
    assert np.array_equal(batch.signal, full.signal, equal_nan=True)
    assert np.array_equal(batch.log_likelihood, full.log_likelihood)


def test_no_records_and_no_rows() -> None:
    model = MODELS["flat start"]
    assert filter_batch(model, np.empty((0, 5, 1))).signal.shape == (0, 5, 1)
    assert filter_batch(model, np.empty((4, 0, 1))).signal.shape == (4, 0, 1)


def test_readings_are_never_changed_and_may_lie_anyhow() -> None:
    model = MODELS["two channels"]
    z = records(model, 5, 300)
    before = z.copy()
    z.flags.writeable = False
    batch = filter_batch(model, z)
    assert np.array_equal(z, before)
    assert np.array_equal(filter_batch(model, np.asfortranarray(z)).signal, batch.signal, equal_nan=True)


@pytest.mark.parametrize("shape", [(5,), (5, 2), (5, 2, 3)])
def test_a_batch_of_the_wrong_shape_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ModelError, match=r"\(records, N, 2\) is needed"):
        filter_batch(MODELS["two channels"], np.zeros(shape))


def test_one_record_too_many_dimensions_names_the_batch() -> None:
    with pytest.raises(ModelError, match="filter_batch"):
        kalman_filter(MODELS["flat start"], np.zeros((2, 3, 1)))
