"""A stream's clock: whole steps where stamps are even, true time where not; what cannot be taken is told."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats
from becalm.core.time.live_clock import FAR, LATE, REPEATED, RESET, TAKEN, UNTIMED, LiveClock
from becalm.core.time.timebase import Timebase
from becalm.errors import ModelError, TimeError


def passed(stamps: ArrayLike, step_s: float = 0.01, resolution_s: float = 0.0) -> tuple[Floats, list[int]]:
    told = LiveClock(step_s, resolution_s).process_stamps(np.asarray(stamps, dtype=float))
    return told.elapsed, told.codes.tolist()


def test_even_stamps_are_single_steps() -> None:
    elapsed, codes = passed(1.7e9 + np.arange(1000) / 100)
    assert elapsed.tolist() == [0.0] + [1.0] * 999
    assert set(codes) == {TAKEN}


def test_a_sender_whose_clock_is_off_by_a_percent_is_followed() -> None:
    elapsed, _ = passed(np.arange(5000) * 0.0101)
    assert np.all(elapsed[1:] == 1.0)


def test_lost_rows_are_whole_steps_and_odd_ones_true_time() -> None:
    elapsed, _ = passed([0.0, 0.01, 0.04, 0.05, 0.0637, 0.0737])
    np.testing.assert_allclose(elapsed, [0, 1, 3, 1, 1.37, 1], atol=1e-12)


def test_jittered_stamps_are_true_time_as_in_a_file() -> None:
    rng = np.random.default_rng(3)
    stamps = np.cumsum(rng.uniform(0.005, 0.015, 400))
    elapsed, _ = passed(stamps)
    true = Timebase.from_stamps(stamps)
    far = np.abs(elapsed - 1) > 0.03
    np.testing.assert_allclose(elapsed[far], (true.elapsed_steps * true.step_s / 0.01)[far], atol=0.021)
    np.testing.assert_allclose(elapsed[1:].sum(), (stamps[-1] - stamps[0]) / 0.01, rtol=2e-3)


def test_stamps_coarser_than_the_step_are_counted() -> None:
    elapsed, codes = passed(np.floor(np.arange(3000) / 10) * 1e-3, 1e-4, 1e-3)
    assert np.all(elapsed[1:] == 1.0)
    assert set(codes) == {TAKEN}


def test_a_lost_row_is_seen_in_stamps_as_coarse_as_the_step() -> None:
    stamps = np.delete(np.arange(50) / 1000, [20, 30, 31])
    elapsed, _ = passed(stamps, 1e-3, 1e-3)
    assert np.flatnonzero(elapsed[1:] != 1.0).tolist() == [19, 28]
    assert elapsed[[20, 29]].tolist() == [2.0, 3.0]


def test_a_row_that_shares_a_coarse_stamp_is_no_repeat() -> None:
    stamps = np.round(np.arange(3000) / 1000.3, 3)
    elapsed, codes = passed(stamps, 1e-3, 1e-3)
    assert set(codes) == {TAKEN}
    assert elapsed.sum() == pytest.approx(2999, rel=2e-3)


def test_a_row_that_came_twice_is_a_repeat_however_coarse_stamps_are() -> None:
    clock = LiveClock(0.01, 0.01)
    told = clock.process_stamps(np.array([0.0, 0.01, 0.01, 0.02]), np.array([False, False, True, False]))
    assert told.codes.tolist() == [TAKEN, TAKEN, REPEATED, TAKEN]
    assert told.elapsed.tolist() == [0.0, 1.0, 0.0, 1.0]


def test_late_and_repeated_rows_are_told() -> None:
    _, codes = passed([0.0, 0.01, 0.02, 0.01, 0.02, 0.03, 0.03, np.nan, 0.04])
    assert codes == [TAKEN, TAKEN, TAKEN, LATE, REPEATED, TAKEN, REPEATED, UNTIMED, TAKEN]


def test_one_wild_stamp_is_left_out_and_eight_are_believed() -> None:
    _, codes = passed([0.0, 0.01, 4e9, 0.02, -1e9, 0.03])
    assert codes == [TAKEN, TAKEN, FAR, TAKEN, LATE, TAKEN]
    elapsed, codes = passed([1.7e9, *(np.arange(10) / 100)])
    assert codes == [TAKEN, *[LATE] * 7, RESET, TAKEN, TAKEN]
    assert elapsed[8:].tolist() == [1.0, 1.0, 1.0]


def test_after_opening_anew_a_stamp_may_be_days_later() -> None:
    clock = LiveClock(0.01)
    clock.process_stamps(np.array([0.0]))
    clock.mark_interruption()
    told = clock.process_stamps(np.array([1e6]))
    assert told.codes.tolist() == [TAKEN]
    np.testing.assert_allclose(told.elapsed, [1e8])


@given(
    st.lists(st.floats(-1e10, 1e10) | st.sampled_from([0.0, 0.01, 0.02, 0.0301, np.nan, np.inf]), max_size=60),
    st.integers(0, 60),
)
def test_no_cut_matters_and_a_pause_neither(stamps: list[float], cut: int) -> None:
    whole = LiveClock(0.01)
    first = whole.process_stamps(np.array(stamps))
    begun = LiveClock(0.01)
    a = begun.process_stamps(np.array(stamps[:cut]))
    b = LiveClock.from_state(begun.state).process_stamps(np.array(stamps[cut:]))
    np.testing.assert_array_equal(first.elapsed, np.concatenate([a.elapsed, b.elapsed]))
    np.testing.assert_array_equal(first.codes, np.concatenate([a.codes, b.codes]))
    assert (first.elapsed >= 0).all()
    assert np.isfinite(first.elapsed).all()


def test_what_is_no_clock_is_refused() -> None:
    for step_s in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(TimeError, match="step_s"):
            LiveClock(step_s)
    for state in (np.zeros(11), np.zeros(3), np.full(11, np.nan)):
        with pytest.raises(ModelError, match="clock"):
            LiveClock.from_state(state)
