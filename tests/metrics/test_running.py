"""Running metrics: blocks of any length give what the whole gives, and the whole gives what the formulas say."""

from __future__ import annotations

import tracemalloc
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from becalm.core.arrays import Floats
from becalm.metrics.whiteness import (
    MOST_LAGS,
    PIECE,
    LaggedSums,
    Running,
    RunningEvenness,
    RunningNis,
    RunningWhiteness,
    Whiteness,
    mean_nis,
    uneven_share,
    whiteness,
)

NOTHING_TOLD = Whiteness(1.0, 0.0, 0.0)


class Found(NamedTuple):
    white: Whiteness
    uneven: float
    nis: float


def found_whole(e: Floats) -> Found:
    return Found(whiteness(e), uneven_share(e), mean_nis(e))


def found_in_blocks(blocks: list[Floats]) -> Found:
    white, even, nis = RunningWhiteness(), RunningEvenness(), RunningNis()
    for block in blocks:
        white.add(block)
        even.add(block)
        nis.add(block)
    return Found(white.result(), even.result(), nis.result())


def assert_same(found: Found, expected: Found, rel: float = 1e-12) -> None:
    assert found.white.p_value == pytest.approx(expected.white.p_value, rel=1e-9, abs=1e-14)
    assert found.white.first_correlation == pytest.approx(expected.white.first_correlation, rel=rel, abs=1e-12)
    assert found.white.predictable_share == pytest.approx(expected.white.predictable_share, rel=rel, abs=1e-12)
    assert found.uneven == expected.uneven
    assert found.nis == pytest.approx(expected.nis, rel=rel, nan_ok=True)


def in_one_go(e: Floats, lags: int) -> Floats:
    """The products about the mean, straight from their definition; the mean is that of extended precision."""
    centred = (e.astype(np.longdouble) - e.astype(np.longdouble).mean()).astype(np.float64)
    return np.array([np.sum(centred[j:] * centred[: len(e) - j]) for j in range(lags + 1)])


def lagged_sums(blocks: list[Floats]) -> LaggedSums:
    running = Running(LaggedSums(), LaggedSums.extended)
    for block in blocks:
        running.add(block)
    return running.sums()


def coloured(rows: int, seed: int = 0) -> Floats:
    e: Floats = lfilter([1.0], [1.0, -0.2], np.random.default_rng(seed).normal(size=rows))
    return e


LENGTHS = st.one_of(st.integers(0, 40), st.integers(41, 1000), st.integers(PIECE - 40, 3 * PIECE))
CUTS = st.lists(st.floats(0, 1), max_size=12)


def cut(e: Floats, shares: list[float]) -> list[Floats]:
    """Cut e at shares of its length; the same share twice makes an empty block."""
    return np.split(e, sorted(round(share * len(e)) for share in shares))


@given(rows=LENGTHS, cuts=CUTS, missing=st.sampled_from([0.0, 1e-4, 0.1, 0.9, 1.0]), seed=st.integers(0, 99))
def test_any_blocks_are_the_whole(rows: int, cuts: list[float], missing: float, seed: int) -> None:
    e, rng = coloured(rows, seed), np.random.default_rng(seed)
    e[rng.random(rows) < missing] = rng.choice([np.nan, np.inf, -np.inf])
    before = e.copy()
    assert_same(found_in_blocks(cut(e, cuts)), found_whole(e))
    assert_same(found_whole(e[np.isfinite(e)]), found_whole(e))
    np.testing.assert_array_equal(e, before)


@pytest.mark.parametrize("size", [1, 7, 33, 50, PIECE - 1, PIECE, PIECE + 1])
def test_even_blocks_are_the_whole(size: int) -> None:
    e = coloured(2 * PIECE + 17)
    e[::101] = np.nan
    assert_same(found_in_blocks([e[start : start + size] for start in range(0, len(e), size)]), found_whole(e))


@given(values=st.lists(st.sampled_from([-2.0, 0.1, 0.3, 1.0, np.nan]), max_size=40), cuts=CUTS)
def test_short_sequences_too(values: list[float], cuts: list[float]) -> None:
    e = np.array(values)
    assert_same(found_in_blocks(cut(e, cuts)), found_whole(e))
    finite = e[np.isfinite(e)]
    if len(finite) < 8 or np.all(finite == finite[0]):
        assert whiteness(e) == NOTHING_TOLD
    else:
        lags = len(finite) // 8
        sums = lagged_sums(cut(e, cuts))
        np.testing.assert_allclose(sums.about_mean(lags), in_one_go(finite, lags), rtol=1e-12, atol=1e-12)


@given(
    value=st.floats(-1e100, 1e100),
    rows=st.sampled_from([1, 8, 40, 500, PIECE, PIECE + 1, 2 * PIECE + 9]),
    cuts=CUTS,
)
def test_of_a_constant_nothing_is_told(value: float, rows: int, cuts: list[float]) -> None:
    found = found_in_blocks(cut(np.full(rows, value), cuts))
    assert found.white == NOTHING_TOLD
    assert found.nis == pytest.approx(value**2, rel=1e-12)


@given(rows=st.sampled_from([0, 1, 300, PIECE + 1]), cuts=CUTS)
def test_of_missing_values_nothing_is_told(rows: int, cuts: list[float]) -> None:
    found = found_in_blocks(cut(np.full(rows, np.nan), cuts))
    assert found.white == NOTHING_TOLD
    assert found.uneven == 0.0
    assert np.isnan(found.nis)


@given(rows=st.integers(64, 3 * PIECE), offset=st.sampled_from([0.0, 3.0, -1e3, 1e6]), seed=st.integers(0, 99))
def test_products_about_the_mean_are_their_definition(rows: int, offset: float, seed: int) -> None:
    e = coloured(rows, seed) + offset
    expected = in_one_go(e, MOST_LAGS)
    np.testing.assert_allclose(lagged_sums([e]).about_mean(MOST_LAGS), expected, rtol=0, atol=1e-11 * expected[0])


@pytest.mark.parametrize("offset", [1e6, -1e9])
def test_a_large_mean_takes_no_digits(offset: float) -> None:
    e = coloured(300_000) + offset
    there = e - offset  # what is left of e, without rounding
    assert_same(Found(whiteness(e), 0.0, 0.0), Found(whiteness(there), 0.0, 0.0), rel=1e-9)


@pytest.mark.parametrize("opening", [PIECE, PIECE + 100, 20])
def test_a_mean_that_jumps_after_the_first_piece_takes_few_digits(opening: int) -> None:
    e = coloured(300_000)
    e[opening:] += 1e6
    expected = in_one_go(e, MOST_LAGS)
    found = lagged_sums([e]).about_mean(MOST_LAGS)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * expected[0])


def test_one_wild_value_at_the_opening_takes_few_digits() -> None:
    e = coloured(300_000)
    e[0] = 1e8
    expected = in_one_go(e, MOST_LAGS)
    np.testing.assert_allclose(lagged_sums([e]).about_mean(MOST_LAGS), expected, rtol=0, atol=1e-11 * expected[0])


@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_beyond_float64_nothing_is_claimed_and_nothing_warned(scale: float) -> None:
    found = found_whole(scale * coloured(3000))
    assert found.white == NOTHING_TOLD
    assert found.uneven == 1.0


def test_a_result_may_be_asked_at_any_time() -> None:
    e = coloured(PIECE + 3000)
    running = RunningWhiteness()
    for start in range(0, len(e), 1000):
        running.add(e[start : start + 1000])
        assert running.result() == running.result() == whiteness(e[: start + 1000])


def test_blocks_of_fifty_run_across_borders() -> None:
    assert PIECE % 50 == 0
    e = np.ones(1000)
    e[100:150] = 3.0
    assert found_in_blocks([e[:120], np.array([np.nan]), e[120:131], e[131:]]).uneven == 1 / 20
    assert uneven_share(np.full(200, 2.0)) == uneven_share(np.full(200, 0.5)) == 0.0  # a factor of four is not more


def test_columns_of_a_table_are_taken_as_they_are() -> None:
    table = np.column_stack([coloured(2 * PIECE, seed) for seed in range(3)])
    for k in range(3):
        assert_same(found_whole(table[:, k]), found_whole(table[:, k].copy()))


def test_memory_does_not_grow_with_the_sequence() -> None:
    block = coloured(1 << 20)
    running = RunningWhiteness()
    running.add(block)
    tracemalloc.start()
    for _ in range(3):
        running.add(block)
    running.result()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000
