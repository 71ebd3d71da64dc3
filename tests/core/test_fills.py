"""Values that are written where no reading came, and zeros at which a sensor rests."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.health.faults import Faults
from becalm.core.health.limits import Limits, find_limits, stuck_at_once
from becalm.core.health.outlier_rule import (
    Outliers,
    find_outlier_rule,
    is_outlier,
    verdicts_from_neighbours,
)
from becalm.core.reading_verdicts import Verdict
from becalm.native.scans import LONGEST_0
from outlier_records import ROWS, found_causally, judged_soon, noise, stairs


@pytest.mark.parametrize("every", [2, 4])
@pytest.mark.parametrize("level", [0.0, 40.0])
def test_a_value_that_fills_in_is_known(every: int, level: float) -> None:
    t = np.arange(ROWS)
    z = level + 15 * np.sin(t / 90) + 0.3 * noise()
    z[t % every == 0] = 0.0
    rule = find_outlier_rule(z)
    assert rule.blank == 0.0
    assert (
        np.flatnonzero(is_outlier(z, rule)).tolist()
        == found_causally(z, rule)
        == np.flatnonzero(t % every == 0).tolist()
    )


def test_a_rest_at_zero_fills_nothing_in() -> None:
    """A car that stops, pulses above a floor, a coarse code."""
    t = np.arange(ROWS)
    for z in (np.maximum(0, np.sin(t / 300)) * (5 + 0.1 * noise()), np.round(noise()), (t % 3 == 0) * 5.0):
        assert np.isinf(find_outlier_rule(z).blank)


def test_a_value_that_fills_in_ten_times_is_left_out_though_readings_jump_as_far() -> None:
    z = stairs()
    z[1010:1020] = 0.0
    limits = find_limits(z, np.ones(ROWS), 1.0, 0.005)
    assert np.flatnonzero(verdicts_from_neighbours(z, limits.outliers, stuck_at_once(limits))).tolist() == [
        *range(1010, 1020)
    ]
    lost = np.flatnonzero(Faults(limits).push(z, np.ones(ROWS)))
    assert lost.tolist() == [*range(1010, 1020)], "causally too: no reading of it comes to 0 at once"
    z[1010:1020] = 0.25
    lost = np.flatnonzero(Faults(limits).push(z, np.ones(ROWS)))
    assert lost.tolist() == [*range(1011, 1020)], "the first of another value may be one"


def test_a_channel_that_is_off_for_a_tenth_of_the_record_rests_at_0() -> None:
    """And is left as it reads, though nothing leads there, and on it never repeats a reading."""
    z = 100.0 + 0.02 * noise()
    z[2000:2500] = 0.0
    limits = find_limits(z, np.ones(ROWS), 1.0, 0.01)
    assert not verdicts_from_neighbours(z, limits.outliers, stuck_at_once(limits)).any()
    assert not Faults(limits).push(z, np.ones(ROWS)).any()


def test_a_0_that_lasts_is_believed_by_a_recipe_that_knows_none() -> None:
    z = 100.0 + 0.02 * noise()
    limits = find_limits(z, np.ones(ROWS), 1.0, 0.01)
    z[1000:] = 0.0
    causal = Faults(limits).push(z, np.ones(ROWS))
    assert np.flatnonzero(causal).tolist() == [*range(1000, 1000 + LONGEST_0 - 1)]
    assert not verdicts_from_neighbours(z, limits.outliers, stuck_at_once(limits)).any()
    soon = judged_soon(z, limits, 3, [1500])
    assert np.flatnonzero(soon).tolist() == [*range(1000, 1000 + LONGEST_0 - 4)]
    z[1000:] = 50.0
    assert (Faults(limits).push(z, np.ones(ROWS))[1000:] > 0).all(), (
        "another value is that of a sensor that stands still"
    )


@pytest.mark.parametrize(
    "z",
    [
        20.0 + noise(),  # 0 is as near as readings jump by
        np.round(20.0 + 5 * np.sin(np.arange(ROWS) / 30.0) + 0.1 * noise(), 1),  # that repeat
        np.repeat(20.0 + noise(), 3)[:ROWS],  # of a slower sensor
        np.where(np.arange(ROWS) % 10, np.nan, 20.0 + 0.1 * noise()),  # that come seldom
    ],
    ids=["noise", "codes", "slower", "seldom"],
)
def test_a_0_stands_for_none_where_no_reading_is_near_it(z: Floats) -> None:
    z = z.copy()
    z[1000:1010] = 0.0
    elapsed = np.diff(np.flatnonzero(np.isfinite(z)), prepend=0).astype(float)
    limits = find_limits(z[np.isfinite(z)], elapsed, 1.0, 0.005)
    fills = [*range(1000, 1010)]
    assert (
        np.flatnonzero(verdicts_from_neighbours(z, limits.outliers, stuck_at_once(limits)) == Verdict.OUTLIER).tolist()
        == fills
    )
    assert np.flatnonzero(Faults(limits).push(z, np.ones(ROWS)) == Verdict.OUTLIER).tolist() == fills


def test_a_0_that_is_a_code_as_any_other_is_a_reading() -> None:
    """On both sides of it, or near to it."""
    square = np.round(40 * np.sign(np.sin(np.arange(1, ROWS) / 100.0)) + noise(rows=ROWS - 1))
    for z in (square, np.round(8.0 + 2 * np.sin(np.arange(ROWS) / 100.0) + noise())):
        assert find_outlier_rule(z).far_from_0 == 0


def test_a_channel_that_comes_to_0_step_by_step_rests_there() -> None:
    z = np.append(np.linspace(20, 0, ROWS), np.zeros(50))
    rule = find_outlier_rule(20.0 + 0.1 * noise())
    assert 9 < rule.far_from_0 < 10, "half of how near they come"
    assert not Faults(Limits(outliers=rule._replace(distance=1e3, causal_distance=1e3))).push(z, np.ones(len(z))).any()


def test_a_0_without_others_before_it_is_a_reading_where_it_is_plausible() -> None:
    rule = Outliers(30.0, 60.0, -50.0, 150.0, True, far_from_0=5.0)
    z = np.append(np.zeros(60), np.linspace(0.05, 90.0, 900))
    assert not Faults(Limits(outliers=rule)).push(z, np.ones(len(z))).any()
    assert not is_outlier(z, rule).any()
    z = 100.0 + 0.02 * noise()
    z[:10] = 0.0
    assert found_causally(z, find_outlier_rule(z)) == [*range(10)], "it is not plausible"


def test_a_0_that_stands_for_none_hides_no_outlier_beside_it() -> None:
    z = 100.0 + 0.02 * noise()
    rule = find_outlier_rule(z)
    z[[1001, 1005]], z[1003] = 0.0, 130.0
    assert np.flatnonzero(is_outlier(z, rule)).tolist() == found_causally(z, rule) == [1001, 1003, 1005]


def test_a_0_amid_what_is_plausible_that_lasts_is_a_fault() -> None:
    z = 50 * np.sign(np.sin(np.arange(ROWS) / 50.0)) + noise()
    z[2000:3000] = 0.0
    limits = Limits(outliers=Outliers(60.0, 120.0, -150.0, 150.0, True, far_from_0=10.0), stuck_readings=6)
    for codes in (
        Faults(limits).push(z, np.ones(ROWS)),
        verdicts_from_neighbours(z, limits.outliers, stuck_at_once(limits)),
    ):
        assert (codes[2000 + LONGEST_0 : 3000] == Verdict.STUCK).all()
        assert (codes[2000:3000] > 0).all()


T = np.arange(ROWS)
RESTS = {
    "both signs, a dead band": np.where(np.abs(np.sin(T / 40)) < 0.3, 0.0, np.sin(T / 40) + 0.01 * noise()),
    "a scale between items": np.where(
        T % 100 < 8, 0.0, np.round(1.37 * np.repeat(5 + 55 * np.random.default_rng(3).random(ROWS // 100), 100), 1)
    ),
    "a pump of whole numbers": np.where(T % 600 < 55, 0.0, np.round(100 + 3 * noise())),
    "loads that differ": np.where(
        T % 500 < 30, 0.0, np.repeat([20.0, 55.0, 33.0, 80.0] * 2, 500) + np.round(0.05 * noise(), 2)
    ),
    "a speed that stops": np.maximum(30 * np.sin(T / 300) + 0.1 * noise(), 0.0),
}


@pytest.mark.parametrize("name", RESTS)
def test_a_0_that_a_channel_comes_to_again_and_again_is_its_own(name: str) -> None:
    z = RESTS[name]
    limits = find_limits(z, np.ones(ROWS), 1.0, 0.01)
    assert limits.outliers.far_from_0 == 0
    assert np.mean(verdicts_from_neighbours(z, limits.outliers, stuck_at_once(limits))[z == 0] > 0) < 0.1


@pytest.mark.parametrize("rows", [1, 10, 40])
def test_a_0_amid_quick_motion_far_from_it_stands_for_none(rows: int) -> None:
    z = np.round(12.0 + 8 * np.sin(T / 3.0) + 0.1 * noise(), 3)
    for start in (700, 1900, 3100):
        z[start : start + rows] = 0.0
    limits = find_limits(z, np.ones(ROWS), 1.0, 0.005)
    for codes in (
        Faults(limits).push(z, np.ones(ROWS)),
        verdicts_from_neighbours(z, limits.outliers, stuck_at_once(limits)),
    ):
        assert np.array_equal(codes > 0, z == 0)


@pytest.mark.parametrize("gone", [1127, 1100, 1131])
def test_a_hole_in_a_run_of_0_tells_the_same_wherever_rows_are_cut(gone: int) -> None:
    z = 100.0 + 0.02 * noise()
    limits = find_limits(z, np.ones(ROWS), 1.0, 0.01)
    z[1000:1300], z[gone] = 0.0, np.nan
    assert np.array_equal(judged_soon(z, limits, 3, [*range(990, 1310)]), judged_soon(z, limits, 3, [1]))


@pytest.mark.parametrize("every", [3, 10, 40])
def test_a_sensor_that_reads_seldom_is_followed_beyond_what_was_plausible(every: int) -> None:
    z = np.where(T % every, np.nan, 20.0 + 0.1 * noise())
    told = np.isfinite(z)
    limits = find_limits(z[told], np.full(told.sum(), float(every)), 1.0, 0.01)
    z = np.where(told, 20.0 + 20 * T / ROWS + 0.1 * noise(1), np.nan)
    assert np.count_nonzero(Faults(limits).push(z, np.ones(ROWS)) == Verdict.OUTLIER) == 0
    z = np.where(told, np.where(T < 2000, 20.0, 500.0) + 0.1 * noise(1), np.nan)
    assert np.count_nonzero(Faults(limits).push(z, np.ones(ROWS)) == Verdict.OUTLIER) <= 4


def test_a_0_that_others_lead_to_is_no_fill() -> None:
    z, limits = stairs(), find_limits(stairs(), np.ones(ROWS), 1.0, 0.005)
    z[1000:1010] = np.linspace(z[1000], 0.1, 10)
    z[1010] = 0.0
    assert not Faults(limits).push(z, np.ones(ROWS))[1010]


def test_a_rest_that_comes_slowly_is_none() -> None:
    rng = np.random.default_rng(6)
    speed = np.maximum(30 * np.sin(np.arange(ROWS) / 300.0), 0.0)
    z = np.where(speed > 0, speed + 0.01 * rng.normal(size=ROWS), 0.0)
    limits = find_limits(z, np.ones(ROWS), 1.0, 0.01)
    assert not verdicts_from_neighbours(z, limits.outliers, stuck_at_once(limits)).any()
    assert not Faults(limits).push(z, np.ones(ROWS)).any()


def test_a_zero_that_no_reading_comes_near_is_no_rest() -> None:
    z = 20.0 + 5 * np.sin(np.arange(ROWS) / 3.0) + 0.1 * noise(7)
    z[500:540] = 0.0
    limits = find_limits(z, np.ones(ROWS), 1.0, 0.01)
    assert limits.stuck_readings is not None
    assert (Faults(limits).push(z, np.ones(ROWS))[500:540] > 0).all()


@pytest.mark.parametrize("every", [2, 4])
def test_a_0_that_lasts_is_believed_where_rows_are_missing(every: int) -> None:
    z = 100.0 + 0.02 * noise()
    limits = Limits(outliers=find_outlier_rule(z)._replace(repeats_are_one=True), stuck_readings=8)
    z[1000:] = 0.0
    z[np.arange(ROWS) % every > 0] = np.nan
    for codes in (
        judged_soon(z, limits, 3, [1500]),
        verdicts_from_neighbours(z, limits.outliers, stuck_at_once(limits)),
    ):
        assert not codes[1000 + LONGEST_0 :].any()
