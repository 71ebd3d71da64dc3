"""A bank with a fixed lag: each row is the smoother's on the record cut within the lag; a file is the stream."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from banks import bank_of, record
from becalm.core.arrays import Floats
from becalm.core.imm.fixed_lag_flow import FixedLagImmFlow
from becalm.core.imm.flow import ImmFlow
from becalm.core.online import Online
from becalm.core.reading_verdicts import Verdict
from becalm.errors import ModelError

ROWS = 300
BANKS = {"2 of 1": bank_of(1, 2), "3 of 2": bank_of(2, 3)}
LAGS = [1, 3, 4, 20, 400]
names = st.sampled_from(sorted(BANKS))
cuts = st.lists(st.integers(0, ROWS), max_size=6).map(sorted)
Both = tuple[Floats, Floats]


def told(flow: FixedLagImmFlow | ImmFlow, z: Floats, elapsed: Floats, at: list[int]) -> Both:
    """Return signal and sigma of a record that is cut."""
    pieces = zip(np.split(z, at), np.split(elapsed, at), strict=True)
    parts = [part for some, steps in pieces for part in flow.push(some, steps)] + flow.finish()
    signal, sigma = (np.concatenate([part[field] for part in parts]) for field in (0, 1))
    return signal, sigma


def lagged(name: str, lag: int, kind: str, at: list[int]) -> Both:
    return told(FixedLagImmFlow(BANKS[name], lag=lag), *record(ROWS, kind), at)


def same(got: Floats, expected: Floats) -> bool:
    return np.array_equal(np.ascontiguousarray(got).view(np.uint64), np.ascontiguousarray(expected).view(np.uint64))


def known_until(row: int, lag: int) -> int:
    """Return the end of the record that a row knows: a multiple of a quarter of the lag, if the record is so long."""
    every = max(1, (lag + 1) // 4)
    return min(-(-(row + 2 + lag - every) // every) * every, ROWS)


@pytest.mark.parametrize("kind", ["even", "holes", "uneven"])
@pytest.mark.parametrize("lag", LAGS)
@pytest.mark.parametrize("name", BANKS)
def test_a_row_is_that_of_the_record_cut_within_the_lag(name: str, lag: int, kind: str) -> None:
    (signal, sigma), (z, elapsed) = lagged(name, lag, kind, []), record(ROWS, kind)
    assert len(signal) == ROWS
    for row in range(0, ROWS, 23):
        end = known_until(row, lag)
        assert end == ROWS or row + 0.75 * lag < end <= row + lag + 1
        cut = told(ImmFlow(BANKS[name], causal=False), z[:end], elapsed[:end], [])
        assert same(signal[row], cut[0][row])
        assert same(sigma[row], cut[1][row])


@given(name=names, lag=st.sampled_from(LAGS), kind=st.sampled_from(["holes", "uneven"]), at=cuts)
@settings(max_examples=40)
def test_stretches_are_the_whole_to_the_bit(name: str, lag: int, kind: str, at: list[int]) -> None:
    whole, parts = (lagged(name, lag, kind, cut) for cut in ([], at))
    assert same(whole[0], parts[0])
    assert same(whole[1], parts[1])


@given(name=names, lag=st.sampled_from(LAGS), at=cuts)
@settings(max_examples=40)
def test_live_is_the_file_so_much_later_whatever_the_pauses(name: str, lag: int, at: list[int]) -> None:
    online, got = Online(BANKS[name], lag=lag), []
    for some in np.split(record(ROWS, "holes")[0], at):
        got.append(online.run(some))
        online = Online.resume(online.snapshot())
    for field, expected in enumerate(lagged(name, lag, "holes", [])):
        late, last = np.vstack([told[field] for told in got])[:, 0], online.finish()[field][:, 0]
        assert not np.isfinite(late[:lag]).any()
        assert same(np.concatenate([late[lag:], last]), expected)


def test_one_by_one_is_one_block_to_the_bit() -> None:
    online, z = Online(BANKS["3 of 2"], lag=6), record(ROWS, "holes")[0]
    one_by_one = np.array([online.step(reading) for reading in z.tolist()])
    whole = Online(BANKS["3 of 2"], lag=6)
    assert same(one_by_one.T[:, :, np.newaxis], np.array(whole.run(z)))
    assert online.modes == whole.modes


def test_a_lag_lies_between_the_filter_and_the_smoother() -> None:
    """Jumps of 2 sigma, among rests: with every reading that is waited for less is left of them."""
    bank, truth = bank_of(1, 2), np.repeat(np.tile([0.0, 2.0], 20), 100)
    z, elapsed = truth + np.random.default_rng(1).normal(size=len(truth)), np.ones(len(truth))
    causal, smooth = (told(ImmFlow(bank, causal=causal), z, elapsed, [])[0] for causal in (True, False))
    late = [told(FixedLagImmFlow(bank, lag=lag), z, elapsed, [])[0] for lag in (2, 8, 100)]
    errors = [float(np.std(signal - truth)) for signal in (causal, *late[:2], smooth)]
    assert errors == sorted(errors, reverse=True)
    assert np.std(late[2] - smooth) < 0.01 * errors[-1]


def test_parts_and_verdicts_come_with_their_rows() -> None:
    bank, (z, elapsed) = bank_of(2, 3, share=0.05, rejects=True), record(ROWS, "holes")
    row = int(np.flatnonzero(np.isfinite(z))[200])
    z[row] += 300.0
    flow, whole = (FixedLagImmFlow(bank, lag=10, split=True), ImmFlow(bank, causal=False, split=True))
    late, smooth = ([*one.push(z, elapsed), *one.finish()] for one in (flow, whole))
    verdicts = [np.concatenate([part.verdicts for part in one]) for one in (late, smooth)]
    assert np.array_equal(verdicts[0], verdicts[1])
    assert np.array_equal(np.flatnonzero(verdicts[0] == Verdict.MISSING), np.flatnonzero(np.isnan(z)))
    assert verdicts[0][row] == Verdict.SPIKE
    parts = np.hstack([part.parts for part in late])
    assert parts.shape == (1 + 3, ROWS)
    np.testing.assert_allclose(parts[1:, 5:].sum(axis=0), 1.0, rtol=1e-12)
    assert flow.shares == whole.shares
    assert flow.log_likelihood == pytest.approx(whole.log_likelihood)


@pytest.mark.parametrize("lag", [1.5, -1, 10**12])
def test_what_is_no_lag_is_refused(lag: float) -> None:
    for make in (lambda: FixedLagImmFlow(BANKS["2 of 1"], lag=lag), lambda: Online(BANKS["2 of 1"], lag=lag)):  # type: ignore[arg-type]
        with pytest.raises(ModelError, match=r"give (a whole number|up to)"):
            make()


def test_a_snapshot_of_another_lag_is_refused() -> None:
    online = Online(BANKS["2 of 1"], lag=5)
    online.run(np.arange(20.0))
    blob = online.snapshot()
    assert len(Online.resume(blob).finish()[0]) == 5
    spoilt = blob.replace(b"waiting_notes", b"waiting_noted")
    with pytest.raises(ModelError, match="snapshot"):
        Online.resume(spoilt)
