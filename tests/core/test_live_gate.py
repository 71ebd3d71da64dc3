"""A live gate decides as that of a file does; any cut, and any pause, decides the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.filter.gate import Gate
from becalm.core.model.model import Model
from becalm.core.online import Online
from becalm.core.reading_verdicts import Verdict
from becalm.errors import ModelError
from flows import flow_of
from gated_streams import GATE, PARTS, in_chunks, model_of

ROWS = 1500


def readings(order: int) -> Floats:
    rng = np.random.default_rng(order)
    z = rng.normal(size=ROWS) + np.where(rng.random(ROWS) < 0.02, 15.0, 0.0)
    z[:5], z[10] = rng.normal(size=5), np.nan
    z[700:] += 60.0
    z[703], z[1000:1004], z[1200] = np.inf, np.nan, 1e300
    return z


@pytest.mark.parametrize("order", [1, 2, 3])
def test_live_is_the_file(order: int) -> None:
    z = readings(order)
    elapsed = np.ones(ROWS)
    flow = flow_of(PARTS[order], 1.0, causal=True, gate=GATE)
    told = [*flow.push(z, elapsed), *flow.finish()]
    signal, sigma, verdicts = in_chunks(Online(model_of(order), gate=GATE), z, [])
    assert np.array_equal(verdicts, np.concatenate([part.verdicts for part in told]))
    assert {Verdict.SPIKE, Verdict.STEP, Verdict.MISSING, Verdict.NONFINITE, Verdict.OVERRANGE} <= set(verdicts)
    np.testing.assert_allclose(signal[:, 0], np.concatenate([part.signal for part in told]), rtol=1e-12, atol=1e-10)
    np.testing.assert_allclose(sigma[:, 0], np.concatenate([part.sigma for part in told]), rtol=1e-12)


@settings(max_examples=30)
@given(st.lists(st.integers(0, ROWS), max_size=8).map(sorted), st.integers(0, ROWS))
def test_any_cuts_and_a_pause_decide_the_same(cuts: list[int], pause: int) -> None:
    z = readings(2)
    whole = in_chunks(Online(model_of(2), gate=GATE), z, [])
    cut = in_chunks(Online(model_of(2), gate=GATE), z, cuts)
    first = Online(model_of(2), gate=GATE)
    begun = in_chunks(first, z[:pause], [])
    rest = in_chunks(Online.resume(first.snapshot()), z[pause:], [])
    for kind in range(len(whole)):
        assert np.array_equal(whole[kind], cut[kind], equal_nan=True)
        assert np.array_equal(whole[kind], np.concatenate([begun[kind], rest[kind]]), equal_nan=True)


def test_one_by_one_is_the_block() -> None:
    z, online = readings(1), Online(model_of(1), gate=GATE)
    signal, sigma, verdicts = in_chunks(Online(model_of(1), gate=GATE), z, [])
    for k, reading in enumerate(z):
        assert np.array_equal(online.step(float(reading)), (signal[k, 0], sigma[k, 0]), equal_nan=True)
        assert online.verdict == verdicts[k]


def test_without_spikes_the_bits_are_those_without_a_gate() -> None:
    z = np.random.default_rng(1).normal(size=ROWS)
    free, gated = Online(model_of(2)).run(z), Online(model_of(2), gate=Gate(8.0)).run(z)
    assert np.array_equal(free, gated, equal_nan=True)


def test_a_known_start_has_a_gate_from_the_first_reading() -> None:
    model = Model(F=[[1]], H=[[1]], Q=[[0.01]], R=[[1]], x0=[0], P0=[[1]])
    online = Online(model, gate=GATE)
    online.step(100.0)
    assert online.verdict == Verdict.SPIKE
    for _ in range(GATE.agree - 2):
        online.step(100.0)
    signal, _sigma = online.step(100.0)
    assert int(online.verdict or 0) == Verdict.STEP
    assert signal == pytest.approx(100.0, abs=0.1)


def test_without_a_gate_nothing_is_told() -> None:
    online = Online(model_of(1))
    online.step(1.0)
    assert online.verdict is None
    assert online.verdicts is None


def test_before_the_first_reading_there_is_no_verdict() -> None:
    assert Online(model_of(1), gate=GATE).verdict is None


def test_two_channels_have_no_gate() -> None:
    with pytest.raises(ModelError, match="one channel"):
        Online(Model(F=np.eye(2), H=np.eye(2), Q=np.eye(2), R=np.eye(2)), gate=GATE)


strange = st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e300, 1e99, 1e20, 50.0, 0.0])


@settings(max_examples=50)
@given(st.lists(strange, min_size=1, max_size=120))
def test_whatever_comes_the_state_stays_finite(faults: list[float]) -> None:
    quiet, online = np.random.default_rng(2).normal(size=300), Online(model_of(2), gate=GATE)
    online.run(quiet)
    signal, sigma = online.run(np.array(faults))
    assert np.isfinite(signal).all()
    assert np.isfinite(sigma).all()
    assert abs(online.run(quiet)[0][-1, 0]) < 20.0
