"""RestartingFlow: after a gap beyond what float64 holds the rest is a record of its own, and nothing else changes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import banks
from becalm.core.arrays import Floats
from becalm.core.filter.channel_settings import GapLimit, gap_limit_of, least_gap_limit, longest_gap
from becalm.core.filter.fixed_lag_flow import FixedLagFlow
from becalm.core.filter.gate import Gate
from becalm.core.filter.restarting_flow import CausalFlow, GapDetector, PartialFlow, RestartingFlow
from becalm.core.filter.smoothed_flow import SmoothedFlow
from becalm.core.imm.fixed_lag_flow import FixedLagImmFlow
from becalm.core.imm.flow import ImmFlow
from becalm.core.model.autoregressive import autoregressive
from becalm.core.model.components import gauss_markov, motion, oscillator
from becalm.core.reading_verdicts import Verdict
from becalm.core.rows import EstimatedRows, Judge
from flows import flow_of

ROWS, AT = 1500, 700
PART, VARIANCE, GATE = motion(3, 1e-4), 0.01, Gate(5.0)
BANK = banks.bank_of(2, 2)
OPEN: dict[str, Callable[[Judge | None], PartialFlow]] = {
    "switching": lambda judge: ImmFlow(BANK, causal=True, judge=judge, split=True),
    "switching, smoothed": lambda judge: ImmFlow(BANK, causal=False, judge=judge, split=True),
    "switching, lagged": lambda judge: FixedLagImmFlow(BANK, lag=9, judge=judge, split=True),
}
REACH = gap_limit_of(PART, VARIANCE)


def record() -> tuple[Floats, Floats]:
    """A slow wave in noise with a spike in each half, and 1e8 steps with missing readings about them in its midst."""
    rng = np.random.default_rng(3)
    z = 5 + np.sin(np.arange(ROWS) / 200) + 0.1 * rng.normal(size=ROWS)
    z[[400, 1100]] += 9.0
    z[AT - 7 : AT] = np.nan
    elapsed = np.ones(ROWS)
    elapsed[AT - 4] = 1e8
    return z, elapsed


def run(
    flow: PartialFlow | CausalFlow | SmoothedFlow | FixedLagFlow,
    readings: tuple[Floats, Floats],
    cuts: list[int] | None = None,
) -> EstimatedRows:
    z, elapsed = readings
    told, cuts = [], cuts or []
    for start, stop in zip([0, *cuts], [*cuts, len(z)], strict=True):
        told += flow.push(z[start:stop], elapsed[start:stop])
    told += flow.finish()
    return EstimatedRows(*(np.concatenate(arrays, axis=-1) for arrays in zip(*told, strict=True)))


def same(one: EstimatedRows, other: EstimatedRows) -> bool:
    return all(np.array_equal(np.asarray(a), np.asarray(b), equal_nan=True) for a, b in zip(one, other, strict=True))


def parted(kind: str, judge: Judge | None = None, gap_limit: GapLimit = REACH) -> RestartingFlow:
    return RestartingFlow(lambda: OPEN[kind](judge), gap_limit)


@pytest.mark.parametrize("kind", OPEN)
def test_both_sides_of_a_long_gap_are_records_of_their_own_to_the_bit(kind: str) -> None:
    z, elapsed = record()
    shown: list[Floats] = []
    flow, before, after = parted(kind, lambda nu, _: shown.append(nu)), OPEN[kind](None), OPEN[kind](None)
    whole = run(flow, (z, elapsed))
    first = run(before, (z[:AT], elapsed[:AT]))
    rest = run(after, (z[AT:], elapsed[AT:]))
    assert same(whole.rows(slice(AT)), first)
    assert same(whole.rows(slice(AT, None)), rest)
    assert np.isfinite(whole.signal).all()
    assert np.isfinite(whole.sigma).all()
    assert flow.log_likelihood == before.log_likelihood + after.log_likelihood
    assert flow.settled_row == before.settled_row
    assert sum(map(len, shown)) == ROWS


@pytest.mark.parametrize("kind", OPEN)
@given(blocks=st.lists(st.integers(0, ROWS // 256), max_size=4))
@settings(max_examples=10)
def test_cut_anywhere_the_bits_are_the_same(kind: str, blocks: list[int]) -> None:
    """At whole blocks, as a smoother of a bank asks."""
    cuts = sorted(256 * block for block in blocks)
    whole, parts = parted(kind), parted(kind)
    one, other = run(whole, record()), run(parts, record(), cuts)
    assert same(one, other)
    assert whole.settled_row == parts.settled_row
    assert whole.shares == pytest.approx(parts.shares, rel=1e-12)


IN_C: dict[str, Callable[[Judge | None], CausalFlow | SmoothedFlow | FixedLagFlow]] = {
    "causal": lambda _: CausalFlow(PART, VARIANCE, GATE),
    "smoothed": lambda judge: SmoothedFlow(PART, VARIANCE, judge=judge, gate=GATE),
    "lagged": lambda judge: FixedLagFlow(PART, VARIANCE, lag=9, judge=judge, gate=GATE),
}


@pytest.mark.parametrize("kind", IN_C)
def test_both_sides_of_a_long_gap_are_records_of_their_own(kind: str) -> None:
    """Of a filter in C, which starts anew by itself, and settles at other rows."""
    z, elapsed = record()
    shown: list[Floats] = []
    flow = IN_C[kind](lambda nu, _: shown.append(nu))
    before, after = (IN_C[kind](None) for _ in range(2))
    whole, first, rest = (
        run(one, (z[rows], elapsed[rows]))
        for one, rows in ((flow, slice(ROWS)), (before, slice(AT)), (after, slice(AT, ROWS)))
    )
    for told, rows in ((first, slice(AT)), (rest, slice(AT, None))):
        np.testing.assert_allclose(whole.signal[rows], told.signal, rtol=1e-11)
        np.testing.assert_allclose(whole.sigma[rows], told.sigma, rtol=1e-9)
        assert np.array_equal(whole.verdicts[rows], told.verdicts)
    if isinstance(flow, CausalFlow) or isinstance(before, CausalFlow) or isinstance(after, CausalFlow):
        return
    assert flow.log_likelihood == pytest.approx(before.log_likelihood + after.log_likelihood, rel=1e-12)
    assert flow.settled_row == before.settled_row
    assert sum(map(len, shown)) == ROWS


@pytest.mark.parametrize("cuts", [[], [256, 1024], [1, 300, 301]])
@pytest.mark.parametrize("kind", OPEN)
def test_a_gap_within_reach_changes_no_bit(kind: str, cuts: list[int]) -> None:
    z, elapsed = record()
    elapsed[AT - 4] = REACH.longest - 8
    assert same(run(parted(kind), (z, elapsed), cuts), run(OPEN[kind](None), (z, elapsed), cuts))


@pytest.mark.parametrize("kind", OPEN)
def test_a_gap_before_the_first_reading_is_none(kind: str) -> None:
    z, elapsed = record()
    readings = z[AT - 5 : AT + 500], elapsed[AT - 5 : AT + 500]
    assert same(run(parted(kind), readings), run(OPEN[kind](None), readings))


def test_verdicts_survive_and_a_bank_tells_the_shares_of_all_parts() -> None:
    z, elapsed = record()
    verdicts = run(flow_of(PART, VARIANCE, causal=True, gate=GATE), (z, elapsed)).verdicts
    assert set(np.flatnonzero(verdicts == Verdict.SPIKE)) == {400, 1100}
    assert set(np.flatnonzero(verdicts == Verdict.MISSING)) == set(range(AT - 7, AT))
    flow, before, after = parted("switching"), OPEN["switching"](None), OPEN["switching"](None)
    assert isinstance(before, ImmFlow)
    assert isinstance(after, ImmFlow)
    run(flow, (z, elapsed)), run(before, (z[:AT], elapsed[:AT])), run(after, (z[AT:], elapsed[AT:]))
    for name, share in flow.shares.items():
        assert share == pytest.approx((AT * before.shares[name] + (ROWS - AT) * after.shares[name]) / ROWS)
    assert sum(flow.shares.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize(("order", "ratio", "gap"), [(3, 1e-2, 1e8), (4, 1e-3, 1e9), (5, 1e-3, 1e6), (5, 1e-3, 1e12)])
@pytest.mark.parametrize("before", [1, 2, 5, 6, 20, 200])
def test_what_follows_a_gap_keeps_to_its_sigma(order: int, ratio: float, gap: float, before: int, causal: bool) -> None:
    rng = np.random.default_rng(before)
    true = np.sin(np.arange(before + 300) / 200)
    z, elapsed, part = true + 0.1 * rng.normal(size=len(true)), np.ones(before + 300), motion(order, ratio * 0.01)
    elapsed[before] = gap
    told = run(flow_of(part, 0.01, causal=causal), (z, elapsed))
    assert (np.abs(told.signal - true) <= 4 * told.sigma)[before:].all()
    assert told.sigma.min() > 0.01


@pytest.mark.parametrize("causal", [True, False])
def test_a_million_missing_rows_are_a_gap(causal: bool) -> None:
    rng = np.random.default_rng(0)
    true = np.sin(np.arange(1_000_600) / 200)
    z, part = true + 0.1 * rng.normal(size=len(true)), motion(5, 1e-5)
    z[300:1_000_300] = np.nan
    told = run(flow_of(part, 0.01, causal=causal), (z, np.ones(len(z))))
    arrived = np.isfinite(z)
    assert (np.abs(told.signal - true) <= 4 * told.sigma)[arrived].all()
    assert np.isfinite(told.signal).all()
    assert np.isfinite(told.sigma).all()


def test_the_longest_step_is_that_of_the_closed_form() -> None:
    """The variance of the level grows by q T^(2n-1) / ((2n - 1) (n-1)!^2)."""
    for order, divisor in ((2, 3.0), (3, 20.0), (4, 252.0), (5, 5184.0)):
        longest = longest_gap(motion(order, 1e-3), 0.1)
        grown = [1e-3 * T ** (2 * order - 1) / divisor for T in (longest, 2 * longest)]
        assert grown[0] <= 1e15 * 0.1 < grown[1]


def test_what_does_not_grow_bridges_everything() -> None:
    for component in (motion(3, 0.0), gauss_markov(10.0), autoregressive([0.5], 1.0)):
        assert longest_gap(component, 1.0) == np.inf
    assert longest_gap(motion(3, 1.0), 0.0) == np.inf
    assert longest_gap(motion(3, 1e40), 1.0) == 2.0
    assert longest_gap(motion(3, 1.0) + oscillator(0.1, 0.01, 1.0), 1.0) == longest_gap(motion(3, 1.0), 1.0)


def test_a_bank_bridges_what_all_modes_do() -> None:
    assert least_gap_limit([GapLimit(9.0, 3.0, 2), GapLimit(8.0, 4.0, 3)]) == GapLimit(8.0, 3.0, 3)


def test_a_gap_that_ends_a_push_is_one_for_the_next() -> None:
    """Rows without a reading, and then a usual one that comes alone: wherever rows are cut, it starts anew."""
    gap_limit, arrived = GapLimit(1024.0, 638.9, 3), np.array([True] * 6 + [False] * 3000 + [True])
    whole, parts = GapDetector(gap_limit), GapDetector(gap_limit)
    assert list(whole.starts(arrived, np.ones(len(arrived)))) == [3006]
    assert list(parts.starts(arrived[:-1], np.ones(3006))) == []
    assert list(parts.starts(arrived[-1:], np.ones(1))) == [0]
