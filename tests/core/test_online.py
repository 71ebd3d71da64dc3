"""Online: the numbers of `kalman_filter`; the same bits for any chunks, and after any pause."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.gate import Gate
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.core.online import Online
from becalm.errors import ModelError
from bits import assert_same_bits

ROWS = 400
MODELS = {
    "level, prior": Model(F=[[1]], H=[[1]], Q=[[0.1]], R=[[1]], x0=[0], P0=[[3]]),
    "level, flat": motion(1, 0.1).to_model(1.0, 1.0),
    "acceleration, flat": motion(3, 1e-3).to_model(1.0, 1.0),
    "two channels, flat": Model(
        F=[[1.0, 1.0], [0.0, 0.9]], H=[[1, 0], [1, 1]], Q=np.eye(2), R=[[1.0, 0.3], [0.3, 2.0]]
    ),
    "two channels, prior": Model(
        F=[[1.0, 1.0], [0.0, 0.9]], H=[[1, 0], [1, 1]], Q=0.1 * np.eye(2), R=np.eye(2), x0=[1, 0], P0=np.ones((2, 2))
    ),
    "unobserved, flat": Model(F=[[1, 1], [0, 1]], H=[[0, 1]], Q=np.eye(2), R=[[1]]),
}


def readings(model: Model) -> Floats:
    """Leading NaN, a slow opening, long settled stretches, gaps."""
    z = np.random.default_rng(11).normal(size=(ROWS, model.channels))
    z[:2], z[3], z[5] = np.nan, np.nan, np.nan
    z[250:254], z[300, -1], z[310] = np.nan, np.inf, np.nan
    return z


RECORDS = {name: (model, readings(model)) for name, model in MODELS.items()}
names = st.sampled_from(sorted(MODELS))
cuts = st.lists(st.integers(0, ROWS), max_size=8).map(sorted)


def in_chunks(online: Online, z: Floats, at: list[int]) -> tuple[Floats, Floats]:
    parts = [online.run(z[start:stop]) for start, stop in zip([0, *at], [*at, len(z)], strict=True)]
    return np.vstack([part[0] for part in parts]), np.vstack([part[1] for part in parts])


@pytest.mark.parametrize("name", MODELS)
def test_a_block_is_the_filter(name: str) -> None:
    model, z = RECORDS[name]
    expected = kalman_filter(model, z)
    signal, sigma = Online(model).run(z)
    np.testing.assert_allclose(signal, expected.signal, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(sigma, expected.sigma, rtol=1e-12)


@pytest.mark.parametrize("name", MODELS)
def test_step_by_step_is_one_block_to_the_bit(name: str) -> None:
    model, z = RECORDS[name]
    expected = Online(model).run(z)
    online = Online(model)
    steps = [online.step(reading) for reading in z]
    assert_same_bits(np.array([signal for signal, _ in steps]), expected[0])
    assert_same_bits(np.array([sigma for _, sigma in steps]), expected[1])


@pytest.mark.parametrize("name", [name for name in MODELS if MODELS[name].channels == 1])
def test_numbers_are_one_block_to_the_bit(name: str) -> None:
    model, z = RECORDS[name]
    expected = Online(model).run(z[:, 0])
    online = Online(model)
    steps = np.array([online.step(reading) for reading in z[:, 0].tolist()])
    assert_same_bits(steps.T[:, :, np.newaxis].copy(), np.array(expected))


@given(name=names, at=cuts)
@settings(max_examples=60)
def test_any_chunks_are_one_block_to_the_bit(name: str, at: list[int]) -> None:
    model, z = RECORDS[name]
    expected = Online(model).run(z)
    signal, sigma = in_chunks(Online(model), z, at)
    assert_same_bits(signal, expected[0])
    assert_same_bits(sigma, expected[1])


@given(name=names, cut=st.integers(0, 12) | st.integers(0, ROWS))
@settings(max_examples=60)
def test_a_paused_stream_forgets_nothing(name: str, cut: int) -> None:
    model, z = RECORDS[name]
    expected = Online(model).run(z)
    online = Online(model)
    before = online.run(z[:cut])
    resumed = Online.resume(online.snapshot())
    after = resumed.run(z[cut:])
    assert_same_bits(np.vstack([before[0], after[0]]), expected[0])
    assert_same_bits(np.vstack([before[1], after[1]]), expected[1])
    assert resumed.snapshot() == continued(online, z[cut:]).snapshot()


def continued(online: Online, z: Floats) -> Online:
    online.run(z)
    return online


def test_a_snapshot_carries_its_model() -> None:
    model = MODELS["two channels, prior"]
    again = Online.resume(Online(model).snapshot()).model
    for name in ("F", "H", "Q", "R", "G", "x0", "P0"):
        assert np.array_equal(getattr(again, name), getattr(model, name))


def test_an_opening_of_nothing_stays_small() -> None:
    online = Online(MODELS["level, flat"])
    signal, sigma = online.run(np.full(10_000, np.nan))
    assert np.isnan(signal).all()
    assert np.isinf(sigma).all()
    assert len(online.snapshot()) < 10_000


def test_a_number_is_a_reading_of_one_channel() -> None:
    for reading in (4.0, 4, np.float64(4), np.float32(4)):
        told = Online(MODELS["level, prior"]).step(reading)
        assert told == pytest.approx((3.0, np.sqrt(0.75)), rel=1e-15)
        assert all(isinstance(number, float) for number in told)


def test_an_empty_block_changes_nothing() -> None:
    online = Online(MODELS["level, prior"])
    before = online.snapshot()
    assert online.run(np.empty(0))[0].shape == (0, 1)
    assert online.snapshot() == before


@pytest.mark.parametrize("reading", [[1.0], [1.0, 2.0, 3.0], 4.0])
def test_a_reading_of_the_wrong_width_is_refused(reading: Any) -> None:
    with pytest.raises(ModelError, match=r"z_k has . values; this model has 2 channels"):
        Online(MODELS["two channels, prior"]).step(reading)


def test_a_block_of_the_wrong_width_is_refused() -> None:
    with pytest.raises(ModelError, match=r"z has shape \(5, 3\); this model needs \(N, 2\)"):
        Online(MODELS["two channels, prior"]).run(np.zeros((5, 3)))


def archive(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def bare_array() -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    return buffer.getvalue()


WHOLE = Online(MODELS["level, prior"]).snapshot()
BAD = {
    "empty": b"",
    "text": b"becalm",
    "half": WHOLE[: len(WHOLE) // 2],
    "no end": WHOLE[:-30],
    "spoilt": WHOLE[:200] + bytes(50) + WHOLE[250:],
    "another archive": archive(a=np.zeros(3)),
    "a bare array": bare_array(),
    "model missing": archive(version=2, opening=np.empty((0, 1)), fresh=True),
    "model impossible": archive(version=2, opening=np.empty((0, 1)), fresh=True, model_F=np.zeros((2, 3))),
}


@pytest.mark.parametrize("name", BAD)
def test_bytes_that_are_no_snapshot_are_refused(name: str) -> None:
    with pytest.raises(ModelError):
        Online.resume(BAD[name])


def test_a_snapshot_of_another_version_is_refused() -> None:
    with pytest.raises(ModelError, match="version 99; this becalm reads 4"):
        Online.resume(archive(version=99))


def test_a_silent_channel_does_not_make_the_opening_grow() -> None:
    model = Model(F=np.eye(2), H=np.eye(2), Q=np.eye(2) * 1e-3, R=np.eye(2))
    online = Online(model)
    z = np.column_stack([np.random.default_rng(1).normal(size=400), np.full(400, np.nan)])
    online.run(z[:100])
    early = len(online.snapshot())
    signal, sigma = online.run(z[100:])
    assert len(online.snapshot()) == early
    assert np.isfinite(signal[:, 0]).all()
    assert (sigma[:, 0] < 1).all()
    assert np.isinf(sigma[:, 1]).all()


@pytest.mark.parametrize("name", ["live"])
def test_a_snapshot_of_other_shapes_is_refused(name: str) -> None:
    online = Online(motion(2, 1e-3).to_model(0.01, 0.09))
    online.run(np.random.default_rng(1).normal(size=50))
    with np.load(io.BytesIO(online.snapshot())) as stored:
        arrays = {key: stored[key] for key in stored.files}
    for wrong in (np.ones(9), arrays[name].astype(np.float32), arrays[name] * np.nan):
        buffer = io.BytesIO()
        np.savez(buffer, **{**arrays, name: wrong})
        with pytest.raises(ModelError, match="snapshot"):
            Online.resume(buffer.getvalue())


PAUSED = {
    "single": Online(MODELS["acceleration, flat"]),
    "single, gated": Online(MODELS["acceleration, flat"], gate=Gate(4.0)),
    "single, late": Online(MODELS["acceleration, flat"], 5),
    "several": Online(MODELS["two channels, flat"]),
    "several, late": Online(MODELS["two channels, flat"], 5),
}


@given(st.sampled_from(sorted(PAUSED)), st.integers(0, 60), st.integers(0, 1 << 16), st.binary(min_size=1, max_size=9))
@settings(max_examples=300, deadline=None)
def test_a_damaged_state_is_refused_or_does_no_harm(kind: str, rows: int, at: int, flips: bytes) -> None:
    online = Online.resume(PAUSED[kind].snapshot())
    z = np.random.default_rng(3).normal(size=(200, online.model.channels))
    online.run(z[:rows])
    with np.load(io.BytesIO(online.snapshot())) as stored:
        arrays = {key: stored[key] for key in stored.files}
    name = "live" if "live" in arrays else "lag_state"
    state = arrays[name].view(np.uint8).copy()
    at %= len(state)
    part = state[at : at + len(flips)]
    part ^= np.frombuffer(flips, np.uint8)[: len(part)]
    buffer = io.BytesIO()
    np.savez(buffer, **{**arrays, name: state.view(arrays[name].dtype)})
    try:
        damaged = Online.resume(buffer.getvalue())
    except ModelError:
        return
    with np.errstate(all="ignore"):
        for signal, sigma in (damaged.run(z[rows:]), damaged.finish()):
            assert signal.shape == sigma.shape
            assert not (sigma < 0).any()


@pytest.mark.parametrize("lag", [0, 2, 5])
@pytest.mark.parametrize("n", [1, 2])
def test_what_is_known_exactly_stays_known(n: int, lag: int) -> None:
    """No noise at all: sigma is 0, and a snapshot, whose variances rounding leaves about 0, is taken."""
    model = Model(np.eye(n) + np.eye(n, k=1), np.eye(1, n), np.zeros((n, n)), [[0.0]], x0=np.zeros(n), P0=np.eye(n))
    online, told = Online(model, lag), list[tuple[Any, Any]]()
    for k in range(9):
        told.append(online.step(float(k)))
        online = Online.resume(online.snapshot())
    signal = [one for one, _ in told][lag:] + online.finish()[0][:, 0].tolist()
    expected = (
        kalman_smoother(model, np.arange(9.0)).signal[:, 0] if lag else kalman_filter(model, np.arange(9.0)).signal
    )
    np.testing.assert_allclose(signal[2 : -lag or None], np.ravel(expected)[2 : -lag or None], atol=1e-12)


def test_sigma_of_exact_readings_is_a_number_throughout() -> None:
    H = [[1.0309217445385483, 1.8178460987289433]]
    Q = np.diag([0.08245130993450477, 38.57787580730414])
    model = Model(np.eye(2), H, Q, [[0.0]], x0=[-0.1096, -1.1679], P0=1e-6 * np.eye(2))
    assert np.isfinite(kalman_smoother(model, np.zeros(300)).sigma).all()


def unstable(rng: np.random.Generator, n: int, m: int = 1) -> tuple[Model, Floats]:
    """Return a model that grows by about 3 from row to row, and its readings, of which most are missing."""
    F = np.eye(n) + rng.normal(size=(n, n))
    model = Model(3.0 / np.abs(np.linalg.eigvals(F)).max() * F, rng.normal(size=(m, n)), np.eye(n), 1e-6 * np.eye(m))
    z = rng.normal(size=(200, m))
    z[rng.random(200) < 0.7] = np.nan
    return model, z


@pytest.mark.parametrize("lag", [0, 4])
@pytest.mark.parametrize("gate", [None, Gate(4.0, 3, 6)])
def test_a_filter_that_loses_its_digits_starts_anew(gate: Gate | None, lag: int) -> None:
    restarts = 0
    for seed in range(20):
        model, z = unstable(np.random.default_rng(seed), 6)
        online = Online(model, lag, gate)
        signal, sigma = online.run(z)
        known = np.isfinite(signal)
        assert (sigma[known] > 0).all()
        assert np.isinf(sigma[~known]).all()
        restarts += int((np.diff(known[lag:, 0].astype(int)) == -1).sum())
        Online.resume(online.snapshot())  # nothing in it is impossible
        assert_same_bits(in_chunks(Online(model, lag, gate), z, [3, 50, 51, 120])[0], signal)
    assert restarts


@pytest.mark.parametrize("lag", [0, 4])
def test_a_filter_of_two_channels_that_loses_its_digits_says_nothing_any_more(lag: int) -> None:
    lost = 0
    for seed in range(20):
        model, z = unstable(np.random.default_rng(seed), 6, 2)
        online = Online(model, lag)
        signal, sigma = online.run(z)
        known = np.isfinite(signal)
        assert (sigma[known] > 0).all()
        assert np.isinf(sigma[~known]).all()
        lost += not known[-1].any()
        Online.resume(online.snapshot())
        assert_same_bits(in_chunks(Online(model, lag), z, [3, 50, 51, 120])[0], signal)
        smoothed = kalman_smoother(model, z)
        assert np.array_equal(np.isfinite(smoothed.signal), np.isfinite(smoothed.sigma))
    assert lost
