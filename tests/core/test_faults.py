"""Faults of readings: told in time, the same wherever the readings are cut, and never on healthy ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Codes, Floats
from becalm.core.health.faults import Faults, fault_messages
from becalm.core.health.limits import Limits, find_limits
from becalm.core.reading_verdicts import ADVICE, Verdict
from becalm.errors import UsageError
from sensor_faults_records import ALARMS_PER_HOUR, LEARNT, SIGNALS, STEPS, digitised, record

LIMITS = Limits(low=-5.0, high=5.0, resolution=1.0, stuck_readings=4)
RATE_HZ = 500


def even(count: int) -> Floats:
    elapsed = np.ones(count)
    elapsed[:1] = 0.0
    return elapsed


def codes_of(z: list[float], elapsed: list[float] | None = None, limits: Limits = LIMITS) -> list[str]:
    steps = even(len(z)) if elapsed is None else np.array(elapsed)
    return [Verdict(code).name for code in Faults(limits).push(np.array(z), steps)]


def test_the_numbers_of_the_verdicts_are_fixed() -> None:
    names = ["USED", "MISSING", "NONFINITE", "OVERRANGE", "SPIKE", "STEP", "CLIPPED"]
    names += ["STUCK", "DEAD", "DRIFT", "LATE", "REPEATED", "GAP", "OUTLIER", "HOLE", "RUNAWAY"]
    assert [verdict.name for verdict in Verdict] == names
    assert [int(verdict) for verdict in Verdict] == list(range(len(names)))
    assert all(ADVICE[Verdict(number)].endswith(".") for number in range(6, len(names)))


def test_a_run_of_equal_readings_is_stuck_from_the_stated_one_on() -> None:
    z = [1.0, 2, 2, 2, 2, 2, 1, 1, 1, 2]
    assert codes_of(z) == ["USED"] * 4 + ["STUCK"] * 2 + ["USED"] * 4
    assert LIMITS.stuck_readings == 4
    assert set(codes_of([2.0] * 50, limits=Limits())) == {"USED"}


def test_what_is_missing_or_written_twice_neither_ends_a_run_nor_lengthens_it() -> None:
    assert codes_of([2.0, np.nan, 2, np.inf, 2, 2])[-2:] == ["USED", "STUCK"]
    assert codes_of([2.0, 2, 2, 2, 2], [0, 1, 0, 1, 1])[-2:] == ["USED", "STUCK"]


def test_a_limit_of_equal_readings_beyond_any_record_is_none() -> None:
    assert set(codes_of([2.0] * 50, limits=LIMITS._replace(stuck_readings=1 << 64))) == {"USED"}


def test_steps_of_other_rows_are_refused() -> None:
    with pytest.raises(UsageError, match="5 elapsed steps came with 100 rows"):
        Faults(LIMITS).push(np.zeros(100), np.ones(5))


def test_readings_and_limits_may_be_of_any_number() -> None:
    z = np.array([1, 2, 2, 2, 2, 5])
    expected = Faults(LIMITS).push(z.astype(np.float64), np.ones(6))
    whole = LIMITS._replace(low=-5, high=5, largest=1000)
    others: list[Any] = [z, z.astype(np.float32), np.repeat(z, 2)[::2]]
    for readings in others:
        assert np.array_equal(Faults(whole).push(readings, np.ones(6, dtype=np.int64)), expected)


def test_rails_and_what_is_no_reading_are_told() -> None:
    z = [4.9, 5, 5.1, -5, np.nan, np.inf, -np.inf, 1e300, -1e300]
    assert codes_of(z) == ["USED", *["CLIPPED"] * 3, "MISSING", *["NONFINITE"] * 2, *["OVERRANGE"] * 2]
    assert codes_of([5.0] * 6) == ["CLIPPED"] * 6


def test_rows_that_were_lost_or_written_twice_are_told() -> None:
    assert codes_of([0.0, 1, 2, 3, 4], [0, 1, 5, 0, 1]) == ["USED", "USED", "GAP", "REPEATED", "USED"]


def test_a_row_that_comes_late_and_one_that_came_in_time_after_it() -> None:
    z = list(np.arange(200.0))
    elapsed = even(200)
    elapsed[[100, 101, 102]] = 1.4, 1.3, 0.3
    told = codes_of(z, list(elapsed), Limits())
    assert [i for i, name in enumerate(told) if name != "USED"] == [101]
    assert told[101] == "LATE"
    assert set(codes_of(z, list(elapsed), Limits(even=False))) == {"USED"}


def test_a_clock_that_runs_a_little_slow_makes_no_row_late() -> None:
    assert set(codes_of(list(np.arange(20_000.0)), [0.0] + [1.002] * 19_999, Limits())) == {"USED"}


ODD = [0.0, 1.0, 2.0, -0.0, 5.0, -5.0, 7.0, np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300]
READINGS = st.lists(st.tuples(st.sampled_from(ODD), st.sampled_from([0.0, 0.3, 1.0, 1.0, 1.0, 1.4, 1.6, 9.0, 1e300])))


@settings(max_examples=300)
@given(rows=READINGS, cuts=st.lists(st.integers(0, 60), max_size=6).map(sorted))
def test_any_cuts_give_the_same_codes_and_counts(rows: list[tuple[float, float]], cuts: list[int]) -> None:
    z, elapsed = (np.array([row[k] for row in rows], dtype=np.float64) for k in (0, 1))
    before = z.copy(), elapsed.copy()
    whole, cut = Faults(LIMITS), Faults(LIMITS)
    parts: list[Codes] = [cut.push(*pair) for pair in zip(np.split(z, cuts), np.split(elapsed, cuts), strict=True)]
    assert np.array_equal(np.concatenate(parts), whole.push(z, elapsed))
    assert cut.found == whole.found
    assert all(np.array_equal(now, was, equal_nan=True) for now, was in zip((z, elapsed), before, strict=True))


@settings(max_examples=100)
@given(z=st.lists(st.sampled_from(ODD) | st.floats(), max_size=80))
def test_nothing_breaks_the_search_for_limits(z: list[float]) -> None:
    limits = find_limits(np.array(z, dtype=np.float64), even(len(z)), 1.0, 0.01)
    assert limits.low < limits.high
    assert np.isfinite(limits.resolution)
    Faults(limits).push(np.array(z, dtype=np.float64), even(len(z)))


def test_what_was_found_is_said_with_when_and_what_to_do() -> None:
    faults = Faults(LIMITS)
    faults.push(np.array([0.0, 5.0, 1.0, 1.0]), np.array([0.0, 1.0, 1.0, 1.0]))
    faults.push(np.array([1.0, 1.0, 0.0, 9.0]), np.array([1.0, 1.0, 3.0, 1.0]))
    clipped, stuck, gap = fault_messages(faults.found, LIMITS, 0.5)
    assert clipped.startswith("2 readings at a rail or beyond (-5 to 5), first at 0.5 s (row 2). ")
    assert stuck.startswith("1 reading in runs of 4 equal ones or more, first at 2.5 s (row 6). ")
    assert gap.startswith("1 gap of more than 1.5 steps, first at 4 s (row 7). ")
    assert clipped.endswith(ADVICE[Verdict.CLIPPED])
    assert fault_messages({}, LIMITS, 0.5) == []


@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("lsb", STEPS)
def test_a_stuck_channel_is_told_within_the_stated_delay(name: str, lsb: float) -> None:
    for seed in range(5):
        z, elapsed = record(name, 45_000, RATE_HZ, lsb, seed)
        limits = find_limits(z[:LEARNT], elapsed[:LEARNT], ALARMS_PER_HOUR, 1 / RATE_HZ)
        z[40_000:] = z[40_000]
        faults = Faults(limits)
        faults.push(z, elapsed)
        assert limits.stuck_readings is not None
        assert 40_000 <= faults.found[Verdict.STUCK].first_row < 40_000 + limits.stuck_readings < 42_500
        assert set(faults.found) == {Verdict.STUCK}


@pytest.mark.slow
@pytest.mark.parametrize("name", SIGNALS)
def test_hours_of_healthy_readings_raise_no_alarm(name: str) -> None:
    """Seven hours at 500 Hz for one false alarm an hour at most; the margin leaves none, however coarse they are.

    One an hour would be missed once in a thousand times.
    """
    for seed in range(7):
        exact, elapsed = record(name, 3600 * RATE_HZ, RATE_HZ, 0.0, seed)
        for lsb in STEPS:
            z = digitised(exact, lsb)
            faults = Faults(find_limits(z[:LEARNT], elapsed[:LEARNT], ALARMS_PER_HOUR, 1 / RATE_HZ))
            faults.push(z, elapsed)
            assert faults.found == {}, (seed, lsb)
