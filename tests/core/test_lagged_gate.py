"""A fixed lag with a gate decides as a live filter does, and smooths what was decided; any cut does the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Codes, Floats
from becalm.core.filter.fixed_lag_flow import FixedLagFlow
from becalm.core.filter.gate import Gate
from becalm.core.filter.smoothing import run_smoother
from becalm.core.model.model import Model
from becalm.core.online import Online
from becalm.core.reading_verdicts import Verdict
from becalm.errors import ModelError
from flows import flow_of
from gated_streams import GATE, PARTS, in_chunks, model_of, with_jumps

ROWS, LAG = 900, 7
cuts = st.lists(st.integers(0, ROWS), max_size=6).map(sorted)


def readings(order: int) -> Floats:
    """Noise with spikes, a step that lasts, and all that is no number; spikes among the first and last rows too."""
    rng = np.random.default_rng(order)
    z = rng.normal(size=ROWS) + np.where(rng.random(ROWS) < 0.03, 15.0, 0.0)
    z[:4], z[5], z[ROWS - 2] = rng.normal(size=4), 30.0, 90.0
    z[500:] += 60.0
    z[10], z[503], z[600:604], z[700] = np.nan, np.inf, np.nan, 1e300
    return z


def stamps(kind: str) -> Floats:
    elapsed = np.ones(ROWS)
    if kind == "stamps":
        elapsed[1:] = np.random.default_rng(4).exponential(size=ROWS - 1)
    return elapsed


def file(order: int, lag: int, elapsed: Floats, at: list[int]) -> tuple[Floats, Floats, Codes, int | None]:
    made, z, told = FixedLagFlow(PARTS[order], 1.0, lag=lag, gate=GATE), readings(order), []
    for start, stop in zip([0, *at], [*at, ROWS], strict=True):
        told += made.push(z[start:stop], elapsed[start:stop])
    told += made.finish()
    signal, sigma, _, verdicts = (np.concatenate(parts, axis=-1) for parts in zip(*told, strict=True))
    return signal, sigma, verdicts, made.settled_row


@pytest.mark.parametrize("kind", ["even", "stamps"])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_row_is_that_of_the_decided_record_cut_after_the_lag(order: int, kind: str) -> None:
    """What is decided while reading makes a record with holes and jumps, and that is what is smoothed."""
    elapsed, model = stamps(kind), model_of(order)
    signal, sigma, verdicts, _ = file(order, LAG, elapsed, [])
    assert {Verdict.SPIKE, Verdict.STEP} <= set(verdicts)
    z, first = np.where(np.isin(verdicts, (Verdict.USED, Verdict.STEP)), readings(order), np.nan), readings(order)[0]
    z -= first
    jumping = with_jumps(PARTS[order], elapsed, z, verdicts)
    for k in range(0, ROWS, 13):
        until = min(k + LAG + 1, ROWS)
        line = jumping._replace(first=jumping.first[: until + 1], step=jumping.step[:until])
        cut = run_smoother(model, line, z[:until, np.newaxis])
        assert signal[k] - first == pytest.approx(cut.signal[k, 0], rel=1e-9, abs=1e-9)
        assert sigma[k] == pytest.approx(cut.sigma[k, 0], rel=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_it_decides_as_the_causal_filter(order: int) -> None:
    flow = flow_of(PARTS[order], 1.0, causal=True, gate=GATE)
    told = [*flow.push(readings(order), stamps("even")), *flow.finish()]
    verdicts = file(order, LAG, stamps("even"), [])[2]
    assert np.array_equal(verdicts, np.concatenate([part.verdicts for part in told]))
    assert {Verdict.SPIKE, Verdict.STEP, Verdict.MISSING, Verdict.NONFINITE, Verdict.OVERRANGE} <= set(verdicts)


@pytest.mark.parametrize("lag", [1, LAG, 60])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_live_is_the_file(order: int, lag: int) -> None:
    signal, sigma, verdicts, _ = file(order, lag, stamps("even"), [])
    online = Online(model_of(order), lag, GATE)
    told, spread, seen = in_chunks(online, readings(order), [])
    last = online.finish()
    assert np.array_equal(seen, verdicts)
    np.testing.assert_allclose(np.append(told[lag:, 0], last[0][:, 0]), signal, rtol=1e-12, atol=1e-12 * 60)
    np.testing.assert_allclose(np.append(spread[lag:, 0], last[1][:, 0]), sigma, rtol=1e-12)


@settings(max_examples=30)
@given(st.sampled_from([1, 2]), st.sampled_from([1, LAG, 60]), st.sampled_from(["even", "stamps"]), cuts)
def test_stretches_are_the_whole_to_the_bit(order: int, lag: int, kind: str, at: list[int]) -> None:
    whole, parts = file(order, lag, stamps(kind), []), file(order, lag, stamps(kind), at)
    assert np.array_equal(whole[0], parts[0], equal_nan=True)
    assert np.array_equal(whole[1], parts[1])
    assert np.array_equal(whole[2], parts[2])
    assert whole[3] == parts[3]


@settings(max_examples=30)
@given(cuts, st.integers(0, ROWS))
def test_any_cuts_and_a_pause_of_a_stream_decide_the_same(at: list[int], pause: int) -> None:
    z = readings(2)
    whole, cut = (in_chunks(Online(model_of(2), LAG, GATE), z, where) for where in ([], at))
    first = Online(model_of(2), LAG, GATE)
    begun = in_chunks(first, z[:pause], [])
    rest = in_chunks(Online.resume(first.snapshot()), z[pause:], [])
    for kind in range(len(whole)):
        assert np.array_equal(whole[kind], cut[kind], equal_nan=True)
        assert np.array_equal(whole[kind], np.concatenate([begun[kind], rest[kind]]), equal_nan=True)


def test_one_by_one_is_the_block() -> None:
    z, online = readings(2), Online(model_of(2), LAG, GATE)
    signal, sigma, verdicts = in_chunks(Online(model_of(2), LAG, GATE), z, [])
    for k, reading in enumerate(z):
        assert np.array_equal(online.step(float(reading)), (signal[k, 0], sigma[k, 0]), equal_nan=True)
        assert online.verdict == verdicts[k]


def test_without_spikes_the_bits_are_those_without_a_gate() -> None:
    z = np.random.default_rng(1).normal(size=ROWS)
    free, gated = Online(model_of(2), LAG).run(z), Online(model_of(2), LAG, Gate(8.0)).run(z)
    assert np.array_equal(free, gated, equal_nan=True)


def test_a_known_start_has_a_gate_from_the_first_reading() -> None:
    model = Model(F=[[1]], H=[[1]], Q=[[0.01]], R=[[1]], x0=[0], P0=[[1]])
    online = Online(model, 2, GATE)
    online.run([100.0, 0.0, 0.0])
    assert online.verdicts is not None
    assert online.verdicts.tolist() == [Verdict.SPIKE, Verdict.USED, Verdict.USED]
    assert abs(online.finish()[0]).max() < 1e-12


def test_two_channels_have_no_gate() -> None:
    with pytest.raises(ModelError, match="one channel"):
        Online(Model(F=np.eye(2), H=np.eye(2), Q=np.eye(2), R=np.eye(2)), 3, GATE)
