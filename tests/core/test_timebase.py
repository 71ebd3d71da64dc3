"""Time bases: rate by median, jitter, gaps, repeats, reversals; rounding is not jitter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from becalm.core.time.timebase import Timebase
from becalm.errors import TimeError


def test_an_even_time_base() -> None:
    time = Timebase.even(5, rate_hz=50, start_s=2.0)
    assert (time.count, time.uniform, time.jitter_s, time.start_s) == (5, True, 0.0, 2.0)
    assert time.rate_hz == pytest.approx(50, rel=1e-15)
    np.testing.assert_allclose(time.times_s, [2.0, 2.02, 2.04, 2.06, 2.08], rtol=1e-15)
    assert time.duration_s == pytest.approx(0.08, rel=1e-14)
    assert not len(time.gaps)
    assert not len(time.repeats)


@pytest.mark.parametrize("count", [0, 1])
def test_a_rate_needs_no_two_rows(count: int) -> None:
    time = Timebase.even(count, 10)
    assert (time.count, time.duration_s, len(time.times_s)) == (count, 0.0, count)


@pytest.mark.parametrize("rate", [0.0, -5.0, np.nan, np.inf])
def test_what_is_not_a_rate_is_refused(rate: float) -> None:
    with pytest.raises(TimeError, match=r"rate_hz = .* is not a rate"):
        Timebase.even(5, rate)


@pytest.mark.parametrize("rate", [0.01, 1.0, 97.66, 500.0, 204.8, 48_000.0])
@pytest.mark.parametrize("start", [0.0, 1234.5, 1.7e9])
def test_even_stamps_are_uniform_and_give_their_rate(rate: float, start: float) -> None:
    stamps = start + np.arange(5000) / rate
    time = Timebase.from_stamps(stamps)
    assert time.uniform
    assert set(time.elapsed_steps[1:]) == {1.0}
    spacing = float(np.spacing(stamps[-1]))  # what a stamp of this size can resolve
    assert time.rate_hz == pytest.approx(rate, rel=1e-12 + spacing * rate / 5000)
    assert np.abs(time.times_s - stamps).max() <= 4 * spacing


@pytest.mark.parametrize("digits", [3, 4, 6])
@pytest.mark.parametrize("start", [0.0, 77.123, 1.7e9])
def test_rounded_stamps_are_uniform(digits: int, start: float) -> None:
    """97.66 Hz written in milliseconds: the steps are 10 and 11 ms, the time is even."""
    ticks = np.round(start * 10.0**digits) + np.round(np.arange(20_000) / 97.66 * 10.0**digits)
    stamps = ticks / 10.0**digits
    time = Timebase.from_stamps(stamps)
    assert time.uniform
    assert set(time.elapsed_steps[1:]) == {1.0}
    assert time.rate_hz == pytest.approx(97.66, rel=1e-6)
    assert time.jitter_s == pytest.approx(10.0**-digits / np.sqrt(12), rel=0.05)


@pytest.mark.parametrize("rate", [600.0, 700.0, 833.0, 952.0, 995.0, 1010.0, 1660.0])
@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_rates_of_about_a_digit_are_even_and_lose_no_row(rate: float, start: float) -> None:
    """Steps of 1.2 ms in milliseconds are of 1 and 2 ms; none of them is a gap or a repeat."""
    time = Timebase.from_stamps(np.round(start + np.arange(3000) / rate, 3))
    assert time.uniform
    assert time.rate_hz == pytest.approx(rate, rel=2e-5)
    assert set(time.elapsed_steps[1:]) == {1.0}


@pytest.mark.parametrize("lost", [1, 5, 10, 40, 600])
def test_rows_lost_by_chance_stay_lost_in_coarse_stamps(lost: int) -> None:
    for seed in range(20):
        rows = np.delete(np.arange(3000), np.random.default_rng(seed).choice(np.arange(1, 2999), lost, replace=False))
        time = Timebase.from_stamps(rows / 1000)
        assert time.rate_hz == pytest.approx(1000, rel=1e-12)
        assert time.elapsed_steps.sum() == 2999


@pytest.mark.parametrize("rate", [1000.0, 3000.0, 7000.0])
def test_stamps_in_float32_keep_their_rate(rate: float) -> None:
    time = Timebase.from_stamps((1000 + np.arange(2000) / rate).astype(np.float32))
    assert (time.uniform, len(time.gaps), len(time.repeats)) == (True, 0, 0)
    assert time.rate_hz == pytest.approx(rate, rel=1e-6)


@pytest.mark.parametrize("rate", [3e6, 4e6])
def test_a_fast_clock_since_1970_keeps_its_rate(rate: float) -> None:
    time = Timebase.from_stamps(1.7e9 + np.arange(2000) / rate)
    assert (time.uniform, len(time.gaps)) == (True, 0)
    assert time.rate_hz == pytest.approx(rate, rel=1e-5)


@pytest.mark.parametrize("rate", [2100.0, 2500.0, 9000.0])
def test_a_rate_is_asked_for_where_half_of_the_stamps_or_more_repeat(rate: float) -> None:
    """Rows that are lost among so many rows of one stamp would not be seen."""
    with pytest.raises(TimeError, match="More than half of the rows repeat"):
        Timebase.from_stamps(np.round(np.arange(1, 3000) / rate, 3))


def test_a_short_record_is_not_rounded_to_whole_seconds() -> None:
    """Half a millisecond from a whole second on: a digit that all stamps share says nothing about their rounding."""
    stamps = 5 + 1e-6 * np.cumsum(np.random.default_rng(3).uniform(0.7, 1.3, 500))
    assert not Timebase.from_stamps(stamps).uniform


def test_jittered_stamps_are_stamped() -> None:
    rng = np.random.default_rng(1)
    stamps = np.arange(5000) / 99.0 + 5e-4 * rng.normal(size=5000)
    time = Timebase.from_stamps(stamps)
    assert not time.uniform
    assert time.rate_hz == pytest.approx(99, rel=0.01)
    assert time.jitter_s == pytest.approx(5e-4, rel=0.1)
    np.testing.assert_allclose(time.times_s, stamps, rtol=0, atol=1e-9)


def test_one_late_stamp_is_not_rounded_away() -> None:
    stamps = np.arange(1000) / 100.0
    stamps[500] += 0.004
    assert not Timebase.from_stamps(stamps).uniform


def test_whole_steps_may_be_missing_from_a_uniform_time() -> None:
    stamps = np.delete(np.arange(1000) / 100.0, [200, 500, 501, 502, 503])
    time = Timebase.from_stamps(stamps)
    assert time.uniform
    assert list(time.gaps) == [200, 499]
    assert (time.elapsed_steps[200], time.elapsed_steps[499]) == (2.0, 5.0)
    np.testing.assert_allclose(time.times_s, stamps, rtol=1e-12)


def test_rounded_stamps_with_gaps_are_uniform() -> None:
    stamps = np.delete(np.round(np.arange(5000) / 97.66, 3), slice(1000, 1500))
    time = Timebase.from_stamps(stamps)
    assert time.uniform
    assert list(time.gaps) == [1000]
    assert time.elapsed_steps[1000] == 501.0


def test_a_gap_is_more_than_a_step_and_a_half() -> None:
    stamps = np.cumsum([0.0, 1, 1, 1.4, 1, 1, 1.6, 1, 1, 30])
    time = Timebase.from_stamps(stamps)
    assert not time.uniform
    assert list(time.gaps) == [6, 9]


def test_repeats_are_kept_and_named() -> None:
    stamps = np.arange(100) / 10
    stamps[[30, 31, 70]] = stamps[[29, 29, 69]]
    time = Timebase.from_stamps(stamps)
    assert not time.uniform
    assert list(time.repeats) == [30, 31, 70]
    np.testing.assert_allclose(time.times_s, stamps, rtol=1e-12, atol=1e-12)


def test_two_rows_are_enough() -> None:
    time = Timebase.from_stamps([3.0, 3.5])
    assert (time.rate_hz, time.count, time.uniform, time.start_s) == (2.0, 2, True, 3.0)


@pytest.mark.parametrize(
    ("stamps", "says"),
    [
        ([], "no rate; two or more are needed"),
        ([1.0], "no rate; two or more are needed"),
        ([0.0, 1.0, np.nan, 3.0], "row 3 is missing or not finite"),
        ([0.0, 1.0, np.inf], "row 3 is missing or not finite"),
        ([0.0, 2.0, 1.0, 3.0], r"backwards at row 3, from 2 s to 1 s \(1 such row\)"),
        ([5.0, 4.0, 3.0], r"backwards at row 2, .* \(2 such rows\)"),
        ([0.0, 0.0, 0.0, 1.0], "More than half of the rows repeat"),
        ([0.0, 1e10, 2e10], "Rows are 1e.10 s apart"),
        ([0.0, 1e297, 2e297], "Rows are 1e.297 s apart"),
        ([-1.7e308, 0.0, 1.7e308], "Rows are inf s apart"),
        ([0.0, 1e-13, 2e-13], "Rows are 1e-13 s apart"),
        ([7.0, 7.0], "More than half of the rows repeat"),
        ([[0.0, 1.0], [2.0, 3.0]], r"has shape \(2, 2\)"),
    ],
)
def test_what_cannot_serve_as_time_is_refused(stamps: Any, says: str) -> None:
    with pytest.raises(TimeError, match=says):
        Timebase.from_stamps(stamps)


def test_the_callers_stamps_stay_as_they_are() -> None:
    stamps = np.arange(10.0)
    time = Timebase.from_stamps(stamps)
    stamps[:] = -1
    np.testing.assert_allclose(time.times_s, np.arange(10.0), rtol=1e-14)
    for own in (time.elapsed_steps, time.times_s):
        with pytest.raises(ValueError, match="read-only"):
            own[0] = 9.0
