"""A fixed lag tells of each row what the smoother says of it on the record that ends L rows later."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.fixed_lag import fixed_lag_smoother
from becalm.core.model.components import motion, oscillator
from becalm.core.model.model import Model
from becalm.core.online import Online
from becalm.core.steady.dials import motion_filter
from becalm.errors import ModelError
from bits import assert_same_bits

ROWS = 260
ROUNDING = 1e-15  # of variances where readings are exact: sigma is 0, or the root of what rounding leaves
EQUAL = 1e-10  # of sigma, and of the signal in sigmas; 9e-12 is reached, of order 3 at the end of a gap
MODELS = {
    **{f"order {order}": motion(order, 10.0**-order).to_model(1.0, 1.0) for order in (1, 2, 3, 4)},
    "tone": (motion(1, 1e-2) + oscillator(0.11, 0.01, 0.1)).to_model(1.0, 1.0),
    "no process noise": motion(2, 0.0).to_model(1.0, 1.0),
    "prior": Model(F=[[1, 1], [0, 1]], H=[[1, 0]], Q=np.diag([0, 0.01]), R=[[1]], x0=[0, 0], P0=np.eye(2)),
    "wide prior": Model(F=[[1, 1], [0, 1]], H=[[1, 0]], Q=np.diag([0, 0.01]), R=[[1]], x0=[0, 0], P0=1e12 * np.eye(2)),
    "two channels": Model(
        F=[[1.0, 1.0], [0.0, 0.9]], H=[[1, 0], [1, 1]], Q=0.1 * np.eye(2), R=[[1.0, 0.3], [0.3, 2.0]]
    ),
    "unobserved": Model(F=[[1, 1], [0, 1]], H=[[0, 1]], Q=np.eye(2), R=[[1]]),
    "exact readings": Model(F=[[1, 1], [0, 1]], H=[[1, 0]], Q=np.diag([0, 0.01]), R=[[0]], x0=[0, 0], P0=np.eye(2)),
}
names = st.sampled_from(sorted(MODELS))
lags = st.sampled_from([1, 2, 7, 40])
cuts = st.lists(st.integers(0, ROWS), max_size=8).map(sorted)


def readings(model: Model, holes: bool = True) -> Floats:
    """A walk in noise, with nothing at first, and holes in the opening, in one channel, and long ones."""
    rng = np.random.default_rng(11)
    z = 0.3 * np.cumsum(rng.normal(size=(ROWS, model.channels)), axis=0) + rng.normal(size=(ROWS, model.channels))
    if holes:
        z[:3], z[5], z[60, -1], z[140:200], z[-7] = np.nan, np.nan, np.inf, np.nan, np.nan
    return z


def by_definition(model: Model, z: Floats, lag: int) -> tuple[Floats, Floats]:
    cut = [kalman_smoother(model, z[: k + lag + 1]) for k in range(len(z))]
    return np.array([e.signal[k] for k, e in enumerate(cut)]), np.array([e.sigma[k] for k, e in enumerate(cut)])


def in_chunks(online: Online, z: Floats, at: list[int]) -> tuple[Floats, Floats]:
    parts = [online.run(z[start:stop]) for start, stop in zip([0, *at], [*at, len(z)], strict=True)]
    return np.vstack([part[0] for part in parts]), np.vstack([part[1] for part in parts])


@pytest.mark.parametrize("holes", [True, False])
@pytest.mark.parametrize("lag", [1, 5, 40])
@pytest.mark.parametrize("name", MODELS)
def test_a_row_is_that_of_the_record_cut_after_the_lag(name: str, lag: int, holes: bool) -> None:
    model = MODELS[name]
    z = readings(model, holes)
    signal, sigma = fixed_lag_smoother(model, z, lag)
    expected_signal, expected_sigma = by_definition(model, z, lag)
    np.testing.assert_array_equal(np.isnan(signal), np.isnan(expected_signal))
    unit = np.where(np.isfinite(expected_sigma), np.maximum(expected_sigma, 1e-3), 1.0)
    np.testing.assert_allclose(signal / unit, expected_signal / unit, rtol=EQUAL, atol=EQUAL)
    np.testing.assert_allclose(sigma**2, expected_sigma**2, rtol=2 * EQUAL, atol=ROUNDING)


@pytest.mark.parametrize("order", [2, 3])
def test_at_the_end_of_a_long_gap_sigma_keeps_its_digits(order: int) -> None:
    model, lag, gap = motion(order, 1e-2).to_model(1.0, 1.0), 20, slice(100, 1100)
    z = np.random.default_rng(2).normal(size=1200)
    z[gap] = np.nan
    sigma = fixed_lag_smoother(model, z, lag)[1]
    assert sigma[gap.stop - lag - 1, 0] > 1e3
    for k in range(gap.stop - lag - 2, gap.stop + 2):
        assert sigma[k, 0] == pytest.approx(kalman_smoother(model, z[: k + lag + 1]).sigma[k, 0], rel=1e-9)


def test_one_early_reading_is_told_by_what_comes_much_later() -> None:
    model, lag = motion(2, 1e-3).to_model(1.0, 1.0), 30
    z = np.random.default_rng(4).normal(size=700)
    z[1:600] = np.nan
    signal, sigma = fixed_lag_smoother(model, z, lag)
    assert np.isinf(sigma[1 : 600 - lag]).all()
    for k in (0, 600 - lag, 585, 599, 600, 601, 620):
        expected = kalman_smoother(model, z[: k + lag + 1])
        assert signal[k, 0] == pytest.approx(expected.signal[k, 0], rel=1e-10)
        assert sigma[k, 0] == pytest.approx(expected.sigma[k, 0], rel=1e-10)


@pytest.mark.parametrize("name", MODELS)
def test_a_lag_over_the_whole_record_is_the_smoother(name: str) -> None:
    model = MODELS[name]
    z = readings(model)
    expected = kalman_smoother(model, z)
    signal, sigma = fixed_lag_smoother(model, z, 3 * ROWS)
    np.testing.assert_allclose(sigma**2, expected.sigma**2, rtol=2 * EQUAL, atol=ROUNDING)
    np.testing.assert_allclose(signal, expected.signal, rtol=EQUAL, atol=1e-9)


def test_no_lag_is_the_filter_to_the_bit() -> None:
    model = MODELS["order 2"]
    z = readings(model)
    expected = kalman_filter(model, z)
    for got, wanted in zip(fixed_lag_smoother(model, z, 0), (expected.signal, expected.sigma), strict=True):
        assert_same_bits(got, wanted)


@pytest.mark.parametrize("lag", [1, 2, 5, 20])
@pytest.mark.parametrize("ratio", [1e-3, 0.1, 10.0])
def test_the_variance_of_a_random_walk_is_the_closed_form(ratio: float, lag: int) -> None:
    """P+(L) = P+ - (P+ - P_s)(1 - rho^2L): what each later innovation tells is rho^2 of the one before, rho = 1 - K."""
    K = (np.sqrt(ratio**2 + 4 * ratio) - ratio) / 2
    rho, filtered, smoothed = 1 - K, K, K / (2 - K)  # r = 1: the filter leaves K r, the smoother K r / (2 - K)
    expected = smoothed + (filtered - smoothed) * rho ** (2 * lag)
    sigma = fixed_lag_smoother(motion(1, ratio).to_model(1.0, 1.0), np.zeros(4000), lag)[1]
    assert sigma[2000, 0] ** 2 == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_a_settled_sigma_is_the_one_foretold(order: int) -> None:
    ratio, lag = 10.0 ** (-2 * order), 12
    sigma = fixed_lag_smoother(motion(order, ratio).to_model(1.0, 1.0), np.zeros(3000), lag)[1]
    assert sigma[1500, 0] ** 2 == pytest.approx(motion_filter(order, ratio).error_variance(lag), rel=1e-9)


def test_sigma_is_honest_at_every_lag() -> None:
    """Where the model is the truth, errors have the variance that sigma says; within 6 % at five deviations."""
    rng, count = np.random.default_rng(8), 60_000
    truth = np.cumsum(0.3 * rng.normal(size=count))
    z = truth + rng.normal(size=count)
    for lag in (1, 3, 10):
        signal, sigma = fixed_lag_smoother(motion(1, 0.09).to_model(1.0, 1.0), z, lag)
        assert np.mean(((signal[:, 0] - truth) / sigma[:, 0]) ** 2) == pytest.approx(1.0, abs=0.06)


@given(name=names, lag=lags, at=cuts)
@settings(max_examples=60)
def test_any_chunks_of_a_stream_are_one_block_to_the_bit(name: str, lag: int, at: list[int]) -> None:
    model = MODELS[name]
    z = readings(model)
    whole, chunked = Online(model, lag), Online(model, lag)
    expected, got = whole.run(z), in_chunks(chunked, z, at)
    for one, other in zip((*got, *chunked.finish()), (*expected, *whole.finish()), strict=True):
        assert_same_bits(one, other)


@pytest.mark.parametrize("name", MODELS)
def test_a_stream_is_the_record_so_much_later(name: str) -> None:
    model, lag = MODELS[name], 7
    z = readings(model)
    signal, sigma = fixed_lag_smoother(model, z, lag)
    online = Online(model, lag)
    steps = [online.step(reading) for reading in z]
    told, spread = np.array([one for one, _ in steps]), np.array([other for _, other in steps])
    assert np.isnan(told[:lag]).all()
    assert np.isinf(spread[:lag]).all()
    last = online.finish()
    assert_same_bits(np.vstack([told[lag:], last[0]]), signal)
    assert_same_bits(np.vstack([spread[lag:], last[1]]), sigma)


@pytest.mark.parametrize("name", ["order 2", "prior"])
def test_numbers_and_blocks_take_turns(name: str) -> None:
    model = MODELS[name]
    z, online = readings(model), Online(model, 7)
    told = [np.array([online.step(float(row[0])) for row in z[:40]]).T]
    told.append(np.array(online.run(z[40:90]))[:, :, 0])
    told.append(np.array([online.step(float(row[0])) for row in z[90:120]]).T)
    told.append(np.array(online.finish())[:, :, 0])
    whole = Online(model, 7)
    expected = np.hstack([np.array(whole.run(z[:120]))[:, :, 0], np.array(whole.finish())[:, :, 0]])
    assert_same_bits(np.hstack(told), expected)


@given(name=names, lag=lags, cut=st.integers(0, 12) | st.integers(0, ROWS))
@settings(max_examples=60)
def test_a_paused_stream_forgets_nothing(name: str, lag: int, cut: int) -> None:
    model = MODELS[name]
    z = readings(model)
    online = Online(model, lag)
    online.run(z[:cut])
    resumed = Online.resume(online.snapshot())
    for one, other in zip(
        (*resumed.run(z[cut:]), *resumed.finish()), (*online.run(z[cut:]), *online.finish()), strict=True
    ):
        assert_same_bits(one, other)
    assert resumed.snapshot() == online.snapshot()


def test_asking_for_the_rest_changes_nothing() -> None:
    model = MODELS["order 2"]
    z = readings(model)
    asked, left = Online(model, 5), Online(model, 5)
    for online in (asked, left):
        online.run(z[:100])
    asked.finish()
    assert_same_bits(asked.run(z[100:])[0], left.run(z[100:])[0])


@pytest.mark.parametrize("rows", [0, 1, 2, 3, 6])
def test_a_record_shorter_than_the_lag_is_smoothed(rows: int) -> None:
    model = MODELS["order 2"]
    z = np.random.default_rng(3).normal(size=(rows, 1))
    signal, sigma = fixed_lag_smoother(model, z, 10)
    expected = kalman_smoother(model, z)
    np.testing.assert_allclose(signal, expected.signal, rtol=1e-12)
    np.testing.assert_allclose(sigma, expected.sigma, rtol=1e-12)


def test_a_stream_of_nothing_stays_small() -> None:
    online = Online(MODELS["order 2"], 5)
    early = len((online.run(np.full(100, np.nan)), online.snapshot())[1])
    assert np.isnan(online.run(np.full(100_000, np.nan))[0]).all()
    assert len(online.snapshot()) == early
    assert online.finish()[0].shape == (5, 1)


@pytest.mark.parametrize("lag", [-1, 0.5, "10", None])
def test_a_lag_that_is_no_number_of_readings_is_refused(lag: Any) -> None:
    with pytest.raises(ModelError, match="give a whole number, 0 to filter"):
        Online(MODELS["order 2"], lag)


@pytest.mark.parametrize("name", ["prior", "two channels"])
def test_a_snapshot_of_another_lag_is_refused(name: str) -> None:
    model = MODELS[name]
    online = Online(model, 3)
    online.run(readings(model)[:50])
    with np.load(io.BytesIO(online.snapshot())) as stored:
        arrays = {key: stored[key] for key in stored.files}
    waits = "waiting" if "waiting" in arrays else "lag_z"
    for wrong in (np.ones((9, model.channels)), arrays[waits][:, None], arrays[waits].astype(np.float32)):
        buffer = io.BytesIO()
        np.savez(buffer, **{**arrays, waits: wrong})
        with pytest.raises(ModelError, match="snapshot"):
            Online.resume(buffer.getvalue())
