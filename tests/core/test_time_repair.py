"""Wraps of counters and hours of summer time are undone; no other fall is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.time.repair import COUNTERS, HOUR_S, StepStatistics, undo_clock_changes, unwrap

SUNDAY_IN_MARCH = float(np.datetime64("2024-03-31T01:30:00", "s").astype(int))


def steps_of(stamps: Floats, block: int = 97) -> StepStatistics:
    steps = StepStatistics(len(stamps))
    for at in range(0, len(stamps), block):
        steps.add(stamps[at : at + block])
    return steps


@settings(max_examples=60)
@given(
    period=st.sampled_from(COUNTERS),
    share=st.floats(0.005, 0.2),
    spread=st.floats(0.0, 0.2),
    seed=st.integers(0, 1000),
    block=st.integers(1, 400),
)
def test_a_wrapped_counter_runs_on(period: float, share: float, spread: float, seed: int, block: int) -> None:
    rng = np.random.default_rng(seed)
    ticks = max(4.0, share * period)
    true = np.round(rng.uniform(0, period / 2) + np.cumsum(ticks * rng.uniform(1 - spread, 1 + spread, 1000)))
    wrapped = true % period
    steps = steps_of(wrapped, block)
    assert steps.wraps_at == period
    assert steps.falls == true[-1] // period
    blocks = (wrapped[at : at + block].astype(np.int64) for at in range(0, 1000, block))
    np.testing.assert_array_equal(np.concatenate(list(unwrap(blocks, period))), true)


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), block=st.integers(1, 400))
def test_other_falls_are_no_wraps(seed: int, block: int) -> None:
    """A logger that starts anew, or one late row."""
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.integers(5, 15, 2000)).astype(float)
    anew = np.concatenate([stamps, stamps + rng.integers(0, 100)])
    late = stamps.copy()
    late[rng.integers(10, 1990)] -= rng.integers(30, 3000)
    for fallen in (anew, np.abs(late), stamps / 1000.0, stamps[::-1] / 3.0):
        assert steps_of(fallen, block).wraps_at is None


def test_a_wrap_where_rows_are_lost_is_not_clear() -> None:
    ticks = np.arange(0, 3000.0, 10.0)
    lost = np.delete(ticks, slice(20, 40))  # 200 to 390; the counter wraps at 256
    assert steps_of(ticks % 256).wraps_at == 256
    assert steps_of(lost % 256).wraps_at is None


@pytest.mark.parametrize("step_s", [0.01, 1.0, 60.0])
@pytest.mark.parametrize("block", [1, 50, 10_000])
def test_an_hour_put_back_is_undone(step_s: float, block: int) -> None:
    true = np.arange(2000) * step_s
    local = true - HOUR_S * (np.arange(2000) >= 1200)
    steps = steps_of(local, block)
    assert steps.falls_by_hours
    hours = list(undo_clock_changes((local[at : at + block] for at in range(0, 2000, block)), 0.0, steps.median))
    np.testing.assert_allclose(np.concatenate([part.stamps_s for part in hours]), true, atol=1e-9)
    assert (hours[-1].back, hours[-1].forth) == (1, 0)


@pytest.mark.parametrize("step_s", [0.5, 1.0, 60.0])
def test_an_hour_put_forth_is_undone_where_clocks_are(step_s: float) -> None:
    true = np.arange(7200 / step_s) * step_s
    local = true + HOUR_S * (true >= 1800.0)
    (spring,) = undo_clock_changes([local], SUNDAY_IN_MARCH, step_s)
    np.testing.assert_allclose(spring.stamps_s, true, atol=1e-9)
    assert (spring.back, spring.forth) == (0, 1)
    for days in (-1, 7, 91, 119):  # Saturday, April, June, July
        (as_read,) = undo_clock_changes([local], SUNDAY_IN_MARCH + 86_400.0 * days, step_s)
        np.testing.assert_array_equal(as_read.stamps_s, local)
    (off,) = undo_clock_changes([local], SUNDAY_IN_MARCH - 5 * step_s - 77.0, step_s)  # not at the full hour
    np.testing.assert_array_equal(off.stamps_s, local)


def test_falls_of_another_length_are_no_hour() -> None:
    for fall in (1800.0, 3590.0, 3620.0, 7200.0, 0.5):
        local = np.arange(2000.0) * 2.0
        local[900:] -= fall + 2.0
        assert not steps_of(local).falls_by_hours
