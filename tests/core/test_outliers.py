"""Gross outliers: left out one by one, on both sides or causally, and never motion."""

from __future__ import annotations

from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.health.faults import Faults
from becalm.core.health.limits import Limits, find_limits, stuck_at_once
from becalm.core.health.look_ahead import LookAhead
from becalm.core.health.outlier_rule import (
    NO_OUTLIERS,
    Outliers,
    distances_of,
    find_outlier_rule,
    is_outlier,
    verdicts_from_neighbours,
)
from becalm.core.reading_verdicts import Verdict
from becalm.errors import ModelError
from becalm.native.scans import LONGEST_0, REACH, SPREADS
from outlier_records import ROWS, found_causally, judged_soon, noise, stairs

DATA = Path(__file__).parents[3] / "shared" / "data"


def found(z: Floats) -> list[int]:
    """Return the rows of outliers by both sides, as a file is judged that is smoothed."""
    return np.flatnonzero(is_outlier(z, find_outlier_rule(z[np.isfinite(z)]))).tolist()


def found_by(z: Floats, rule: Outliers) -> list[int]:
    """Return the rows of outliers by both sides, as a known rule says."""
    return np.flatnonzero(is_outlier(z, rule)).tolist()


@pytest.mark.parametrize("rows", [8, 12, 20])
def test_few_readings_tell_an_outlier_as_well(rows: int) -> None:
    z = np.linspace(1.0, 3.0, rows) + 0.1 * noise(rows=rows)
    assert found(z) == []
    z[rows // 2] = 50.0
    assert found(z) == [rows // 2]


@pytest.mark.parametrize("row", [0, 1, 2, 3, 2000, 3996, 3998, 3999])
@pytest.mark.parametrize("size", [100.0, 1e4, -1e8, 1e30])
def test_a_reading_far_out_is_an_outlier_and_no_other(row: int, size: float) -> None:
    z = 20.0 + noise()
    z[row] = size
    assert found(z) == [row]
    assert found_causally(z, find_outlier_rule(z)) == [row]


def test_two_outliers_side_by_side_do_not_hide_each_other() -> None:
    z = noise()
    z[[500, 501, 1000, 1002]] = 1e6, -3e4, 1e5, 1e5
    assert found(z) == found_causally(z, find_outlier_rule(z)) == [500, 501, 1000, 1002]


@pytest.mark.parametrize("share", [0.06, 0.1, 0.13])
def test_one_reading_in_eight_may_be_impossible(share: float) -> None:
    rng = np.random.default_rng(6)
    wild = rng.permutation(np.arange(60) < round(share * 60))
    wild[1:] &= ~wild[:-1]
    z = np.where(wild, rng.choice([-1.0, 1.0], 60) * 2.0 ** rng.integers(12, 20, 60), 5 + 0.1 * noise(rows=60))
    assert found(z) == np.flatnonzero(wild).tolist()


def test_pulses_are_no_outliers_if_they_are_many() -> None:
    """A pulse is one reading, a hundred thousand times the noise; all but one are alike."""
    z = 0.01 * noise()
    z[::7] = 1e3 * (1 + 0.2 * np.random.default_rng(7).random(len(z[::7])))
    z[70] = 3e3
    assert found(z) == []


@pytest.mark.parametrize(("lasts", "rings"), [(1.2, False), (2.0, False), (2.0, True), (4.0, False), (4.0, True)])
def test_what_follows_a_peak_shows_that_it_is_no_outlier(lasts: float, rings: bool) -> None:
    """Hits of very different size, ten to a hundred thousand times the noise, that decay, or ring."""
    z, rng = 1e-3 * noise(), np.random.default_rng(8)
    t = np.arange(30)
    shape = np.exp(-t / lasts) * (np.cos(2 * np.pi * t / 4.6) if rings else 1.0)
    for first in range(20, len(z) - 30, 40):
        z[first : first + 30] += rng.uniform(10, 100) * shape
    assert found(z) == []


@pytest.mark.parametrize("rows", [300, 1500, 20_000])
def test_impossible_readings_are_found_in_records_of_any_length(rows: int) -> None:
    rng = np.random.default_rng(9)
    wild = rng.random(rows) < 0.12
    z = 20 + 0.1 * noise(rows=rows) + np.where(wild, rng.choice([-1.0, 1.0], rows) * 10 ** rng.uniform(3, 6, rows), 0.0)
    rule = find_outlier_rule(z)
    assert rule.distance < 100.0
    assert np.mean(is_outlier(z, rule)[wild]) > 0.9


@pytest.mark.parametrize("step", [0.1, 0.5])
@pytest.mark.parametrize("causal", [False, True])
def test_a_long_outage_is_followed(step: float, causal: bool) -> None:
    """A mains voltage is 0 for longer than readings are missing."""
    z = np.round((230 + 2 * np.sin(np.arange(6000) / 500) + 1.2 * noise(rows=6000)) / step) * step
    z[2500:2900] = 0.0
    rule = find_outlier_rule(z, resolution=step)
    rows = found_causally(z, rule) if causal else found_by(z, rule)
    assert rows == (list(range(2500, 2500 + LONGEST_0 - 1)) if causal else [])


@pytest.mark.parametrize(("value", "count"), [*product([0.0, -999.0], [1, 4, 10, LONGEST_0 - 1]), (-999.0, 300)])
def test_equal_readings_far_out_are_outliers(value: float, count: int) -> None:
    z = 9.81 + 0.02 * noise()
    z[1000 : 1000 + count] = value
    rows = list(range(1000, 1000 + count))
    assert found(z) == found_causally(z, find_outlier_rule(z)) == rows


def test_one_reading_in_twenty_may_be_wild() -> None:
    rng = np.random.default_rng(5)
    wild = rng.random(ROWS) < 0.05
    z = np.where(wild, rng.choice([8388607.0, 4194303.0, 1048575.0, 0.0], ROWS), 500_000 + 80 * noise())
    assert np.isin(np.flatnonzero(wild), found(z)).mean() > 0.95
    assert not np.isin(np.flatnonzero(~wild), found(z)).any()


def test_a_record_of_many_outliers_has_nearer_ones_as_well() -> None:
    rng, z = np.random.default_rng(6), np.repeat(50 * noise(1, ROWS // 100), 100) + noise()
    wild = rng.random(ROWS) < 0.01
    z[wild] += rng.choice([-1.0, 1.0], int(wild.sum())) * 2.0 ** rng.uniform(4, 8, int(wild.sum()))
    assert np.isin(np.flatnonzero(wild), found(z)).mean() > 0.9
    assert not np.isin(np.flatnonzero(~wild), found(z)).any()


def half_sine(rows: int, size: float, at: int = 2000) -> Floats:
    """Return a shock of so many rows, in noise of variance 1."""
    z = noise()
    z[at : at + rows] += size * np.sin(np.pi * (np.arange(rows) + 0.5) / rows)
    return z


def drop_test() -> Floats:
    """Return rest, free fall, an impact that rings, and rest: steps and shocks far beyond the noise."""
    rng = np.random.default_rng(7)
    t = np.arange(600)
    z = 9.81 + 0.02 * rng.normal(size=ROWS)
    z[1000:1500] -= 9.81
    z[1500:2100] += 900 * np.exp(-t / 40) * np.cos(0.9 * t)
    return z


MOTION = {
    "noise": noise(),
    "spikes of a gate": noise() + 8 * np.random.default_rng(3).choice([-1.0, 1.0], ROWS),
    "running away": np.cumsum(np.cumsum(noise())),
    "a cubic": 1e-4 * np.arange(ROWS) ** 3.0 + noise(),
    "a step": np.where(np.arange(ROWS) < 2000, 0.0, 1e6) + noise(),
    "levels": np.repeat(1e4 * noise(1, ROWS // 50), 50) + noise(),
    "coarse": np.round(0.1 * noise()),
    "zeros": np.zeros(ROWS),
    "reversals": 300 * np.abs(np.mod(np.arange(ROWS) / 40, 2) - 1) + 0.1 * noise(),
    "a square wave": 50 * np.sign(np.sin((np.arange(ROWS) + 0.5) / 9)) + noise(),
    "every third": np.where(np.arange(ROWS) % 3 == 0, 1e6, 0.0) + noise(),
    "a shock of 3 rows": half_sine(3, 400.0),
    "a shock of 4 rows": half_sine(4, 400.0),
    "a shock of 9 rows": half_sine(9, 400.0),
    "a shock of 40 rows": half_sine(40, 4000.0),
    "a drop test": drop_test(),
    "rest, then shaking": np.where(np.arange(ROWS) < 3000, 0.01, 100.0) * noise(),
}


@pytest.mark.parametrize("name", MOTION)
def test_motion_is_no_outlier(name: str) -> None:
    z = MOTION[name]
    assert found(z) == []
    assert found_causally(z, find_outlier_rule(z)) == [], "nor of the record that it was tuned on"


def test_motion_that_was_never_seen_costs_two_readings_and_locks_nothing_out() -> None:
    """Two that agree are believed: the third reading at a new level is used, and all after it."""
    rule = find_outlier_rule(noise())
    z = np.where(np.arange(ROWS) < 2000, 0.0, 1e4) + noise(1)
    assert found_causally(z, rule) == [2000, 2001]
    assert found_causally(1e4 + noise(1), rule) == [0], "nor at the beginning"


@pytest.mark.parametrize("size", [1e6, -1e12])
@pytest.mark.parametrize("rows", [1, 3, 6, 50])
def test_values_that_are_no_motion_are_outliers_though_they_agree(rows: int, size: float) -> None:
    """A thousand ranges away two that agree are no evidence; fifty are, for nothing is locked out."""
    rule, z = find_outlier_rule(noise()), noise(1)
    z[2000 : 2000 + rows] += size
    assert found_causally(z, rule) == list(range(2000, 2000 + rows))
    alone = rule.without_neighbours
    assert found_causally(z, alone) == list(range(2000, 2000 + rows)), "nor where both sides tell the rest"
    z[2000:] = size + noise(2)[2000:]
    assert found_causally(z, rule)[:50] == list(range(2000, 2050))
    assert not set(found_causally(z, rule)) & set(range(2056, ROWS))


def test_a_walk_that_leaves_what_is_plausible_step_by_step_is_motion() -> None:
    rule = find_outlier_rule(noise())
    assert found_causally(1e7 * np.linspace(0.0, 1.0, ROWS) ** 3 + noise(1), rule) == []


def test_a_wild_beginning_is_no_reading_to_judge_others_by() -> None:
    rule = find_outlier_rule(20.0 + noise())
    z = 20.0 + noise(1)
    z[[0, 1]] = 65535.0, -8388608.0
    assert found_causally(z, rule) == [0, 1]


def test_few_readings_tell_of_no_outlier() -> None:
    assert find_outlier_rule(np.array([0.0, 1e9, 0.0])) == NO_OUTLIERS
    assert find_outlier_rule(np.empty(0)) == NO_OUTLIERS


def test_outliers_beside_jumps_do_not_tell_how_far_readings_jump() -> None:
    z = stairs()
    rng = np.random.default_rng(5)
    rows = rng.choice(ROWS, 60, replace=False)
    z[rows] += rng.choice([-1, 1], 60) * 2.0 ** rng.integers(6, 20, 60)
    assert find_outlier_rule(z).causal_distance < 2.5 * find_outlier_rule(stairs()).causal_distance


def test_an_implausible_reading_beside_a_jump_does_not_hide_there() -> None:
    z = np.repeat([0.0, 2.0, -1.0, 1.0], 200) + 0.05 * np.random.default_rng(8).normal(size=800)
    z[50:800:50] = 1e3
    z[201] = 14.0
    rule = find_outlier_rule(z)
    assert not rule.low <= z[201] <= rule.high
    assert np.flatnonzero(is_outlier(z, rule)).tolist() == sorted([201, *range(50, 800, 50)])


def test_wild_readings_amid_a_gap_do_not_tell_how_far_readings_jump() -> None:
    z = 5.0 + noise()
    alone = find_limits(z, np.ones(ROWS), 1.0, 0.005).outliers
    z[1000:1500] = np.nan
    rows = np.arange(1020, 1480, 100)  # few: many would be a sensor that reads seldom
    z[rows] = 5.0 + 60.0 * (-1.0) ** np.arange(len(rows))
    limits = find_limits(z[np.isfinite(z)], np.diff(np.flatnonzero(np.isfinite(z)), prepend=-1.0), 1.0, 0.005)
    assert limits.outliers.causal_distance < 1.1 * alone.causal_distance
    assert (Faults(limits).push(z, np.ones(ROWS))[rows] == Verdict.OUTLIER).all()


def test_two_wild_readings_far_apart_do_not_bear_each_other_out() -> None:
    z = np.full(ROWS, np.nan)
    z[[6, 240]] = -27.2
    z[300:] = 5.0 + 0.1 * noise()[300:]
    rule = find_outlier_rule(z[300:])
    assert found_causally(z, rule) == [6, 240]


def test_outliers_in_an_empty_stretch_do_not_hide_each_other() -> None:
    z = 5.0 + noise()
    rule = find_outlier_rule(z)
    z[1000:1200] = np.nan
    z[[1013, 1015, 1094, 1132]] = -2.6e5, -250.0, 8198.0, -32760.0
    assert found_by(z, rule) == [1013, 1015, 1094, 1132]
    z[1100:1180:3] = -250.0 + noise(1, 27)  # a sensor that reads seldom, and is there
    assert set(found_by(z, rule)) == {1013, 1094, 1132}


@pytest.mark.parametrize("every", [2, 5])
def test_of_a_slower_sensor_each_new_reading_is_judged_once(every: int) -> None:
    z = np.repeat(np.sin(np.arange(ROWS // every) / 9.0) + 0.01 * noise(8, ROWS // every), every)
    rows = [every * k for k in (100, 201, 333)]
    for row in rows:
        z[row : row + every] = 1e4
    limits = find_limits(z, np.ones(len(z)), 1.0, 0.01)
    outliers = np.flatnonzero(is_outlier(z, limits.outliers))
    assert outliers.tolist() == sorted(row + k for row in rows for k in range(every))


def test_a_wild_reading_that_stands_alone_for_long_is_judged_by_what_is_plausible() -> None:
    z = np.sin(np.arange(ROWS) / 50.0) + 0.01 * noise(9)
    z[0], z[1 : 2 * REACH] = 65_535.0, np.nan
    z[-1], z[-2 * REACH : -1] = -65_535.0, np.nan
    assert found(z) == [0, ROWS - 1]


def test_a_spike_on_coarse_steps_is_found() -> None:
    z = np.repeat(np.round(5 * np.random.default_rng(10).normal(size=60)), 7)
    z[200] = 4.2e7
    assert found(z) == [200]


@st.composite
def records(draw: st.DrawFn) -> Floats:
    """Return noise with motion, outliers, dropouts and holes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    z = rng.normal(size=draw(st.integers(1, 1500)))
    if draw(st.booleans()):
        z = np.round(z, draw(st.integers(0, 2)))
    for _ in range(draw(st.integers(0, 8))):
        at, rows = rng.integers(0, len(z)), rng.integers(1, 2 * REACH)
        kind = draw(st.sampled_from(["step", "hold", "hole", "wild", "shake", "off"]))
        if kind == "step":
            z[at:] += 1e3 * rng.normal()
        elif kind == "hold":
            z[at : at + rows] = 1e4 * rng.normal()
        elif kind == "hole":
            z[at : at + rows] = np.nan
        elif kind == "off":
            z[at : at + rows] = 0.0
        elif kind == "shake":
            z[at : at + rows] *= 1e3
        else:
            z[at] = rng.choice([1e6, -1e9, np.inf])
    return z


@given(records(), st.booleans(), st.sampled_from([None, 2, 6]), st.lists(st.integers(0, 1500), max_size=6))
def test_both_sides_tell_the_same_wherever_the_record_is_cut(
    z: Floats, as_one: bool, stuck: int | None, cuts: list[int]
) -> None:
    limits = Limits(outliers=Outliers(30.0, 60.0, -9.0, 99.0, as_one), stuck_readings=stuck)
    found = verdicts_from_neighbours(np.where(np.isfinite(z), z, np.nan), limits.outliers, stuck_at_once(limits))
    whole = found
    ahead, elapsed = LookAhead(limits), np.arange(len(z), dtype=np.float64)
    bounds = [0, *sorted(min(cut, len(z)) for cut in cuts), len(z)]
    parts = [ahead.push(z[a:b], elapsed[a:b]) for a, b in pairwise(bounds)]
    assert all(len(part[0]) % 256 == 0 for part in parts), "smoothers count on whole blocks"
    rows, steps, far = (np.concatenate(arrays) for arrays in zip(*parts, ahead.finish(), strict=True))
    assert np.array_equal(rows, z, equal_nan=True)
    assert np.array_equal(steps, elapsed)
    assert np.array_equal(far, whole)


@given(records(), st.booleans(), st.sampled_from([None, 8]), st.sampled_from([1, 2, 3]), st.integers(0, 1500))
def test_rows_that_wait_for_few_are_judged_by_them_and_no_others(
    z: Floats, as_one: bool, stuck: int | None, ahead: int, cut: int
) -> None:
    """Wherever rows are cut, and whatever comes later."""
    limits = Limits(outliers=Outliers(30.0, 60.0, -9.0, 99.0, as_one), stuck_readings=stuck)
    codes, cut = judged_soon(z, limits, ahead, [0]), min(cut, len(z))
    assert np.array_equal(judged_soon(z, limits, ahead, [cut]), codes)
    shorter, told = LookAhead(limits, ahead).push(z[:cut], np.ones(cut))[2], max(cut - ahead, 0)
    assert np.array_equal(shorter, codes[:told])


def test_few_rows_after_it_tell_an_outlier_from_a_step_and_a_fill_from_its_first_row() -> None:
    z = 20.0 + noise()
    rule = find_outlier_rule(z)._replace(repeats_are_one=True)
    z[[1000, 1002, 1007]] = 500.0  # alone
    z[2000:] += 300.0  # a step
    z[3000:3010] = 0.0  # what fills in
    codes = judged_soon(z, Limits(outliers=rule, stuck_readings=8), 3, [1])
    assert np.flatnonzero(codes).tolist() == [1000, 1002, 1007, *range(3000, 3010)]
    assert 2000 in found_causally(z, rule)


def test_one_that_repeats_after_a_hole_is_judged_by_what_has_come() -> None:
    hole = np.full(14, np.nan)
    hole[[2, 4, 6, 8, 13]] = 5e6, -4e6, 3e6, 1000.0, 1000.0
    z = np.concatenate([20.0 + noise(rows=100), hole, 20.0 + noise(1, 50)])
    limits = Limits(outliers=Outliers(30.0, 60.0, 0.0, 40.0, True), stuck_readings=8)
    assert np.array_equal(judged_soon(z, limits, 3, [*range(1, len(z))]), judged_soon(z, limits, 3, [1]))


def test_rows_without_readings_after_them_are_judged_by_those_before() -> None:
    """As where a sensor is slower than its log."""
    z = np.full(8000, np.nan)
    z[::10] = 20.0 + noise(rows=800)
    rule = find_outlier_rule(z[::10])
    z[[4000, 6000]] = 500.0
    assert np.flatnonzero(judged_soon(z, Limits(outliers=rule), 3, [1])).tolist() == found_causally(z, rule)


@pytest.mark.parametrize("cuts", [[300, 600, 1000], [803, 830], [870]])
@pytest.mark.parametrize("stuck", [3, 8])
def test_equal_readings_after_seldom_ones_are_the_same_wherever_rows_are_cut(cuts: list[int], stuck: int) -> None:
    """Rows far before are no neighbours, and a run that goes on fills in for nothing."""
    z = np.full(1600, np.nan)
    z[[0, 150, 300, 450, 600, 750]], z[800:] = [0.5, 30, 31, 32, 33, 34], 0.0
    limits = Limits(stuck_readings=stuck, outliers=Outliers(20.0, 20.0, 0.0, 60.0, True))
    ahead, bounds = LookAhead(limits), [0, *cuts, len(z)]
    parts = [ahead.push(z[a:b], np.ones(b - a)) for a, b in pairwise(bounds)]
    codes = np.concatenate([part[2] for part in [*parts, ahead.finish()]])
    assert np.array_equal(codes, verdicts_from_neighbours(z, limits.outliers, stuck_at_once(limits)))


@given(
    st.lists(st.sampled_from([0.0, 0.5, 1.0, 3.0, 4.0, 40.0, -50.0]), min_size=7, max_size=60),
    st.floats(0.5, 20.0),
)
def test_an_outlier_is_far_from_the_median_of_its_neighbours(values: list[float], distance: float) -> None:
    z = np.array(values)
    distances, spreads = distances_of(z)
    far = (distances > distance) & (distances > SPREADS * spreads)
    assert np.array_equal(is_outlier(z, Outliers(distance)), far)


@given(records(), st.booleans(), st.integers(0, 1500))
def test_a_causal_rule_tells_the_same_wherever_the_record_is_cut(z: Floats, as_one: bool, cut: int) -> None:
    limits = Limits(outliers=Outliers(30.0, 60.0, -99.0, 99.0, as_one))
    whole, first, second = Faults(limits), Faults(limits), Faults(limits)
    codes = whole.push(z, np.ones(len(z)))
    told = first.push(z[:cut], np.ones(len(z[:cut])))
    second.load_state_dict({name: array.copy() for name, array in first.state_dict().items()})
    assert np.array_equal(np.append(told, second.push(z[cut:], np.ones(len(z[cut:])))), codes)


@given(records())
def test_nothing_is_locked_out(z: Floats) -> None:
    """Of readings that differ, one in three is believed where they agree with the two before them."""
    rule = Outliers(30.0, 60.0, -1e100, 1e100, False)  # no reading is impossible
    codes = Faults(Limits(outliers=rule)).push(z, np.ones(len(z)))
    seen = z[np.isfinite(z)]
    told = codes[np.isfinite(z)] == Verdict.OUTLIER
    for row in range(6, len(seen)):
        near = np.ptp(seen[row - 2 : row + 1]) <= 1.0 and np.ptp(seen[row - 6 : row - 2]) <= 1.0
        assert not (near and told[row] and abs(seen[row] - seen[row - 3]) > 60.0)


REAL = ["gaitmap/imu_sample.csv", "comma2k19/accelerometer.csv", "comma2k19/gyroscope.csv", "fusion/sensor_data.csv"]


@pytest.mark.parametrize("file", REAL)
def test_no_reading_of_a_real_motion_is_an_outlier(file: str) -> None:
    """Steps of a walker hit the ground with 100 times the noise."""
    if not (DATA / file).exists():
        pytest.skip(f"the recordings are not beside the project ({file})")
    from becalm.files.inputs.opening import read

    recording = read(DATA / file, rate_hz=204.8 if "gaitmap" in file else None)
    for z in recording.samples.T:
        limits = find_limits(z, recording.timebase.elapsed_steps, 1.0, recording.timebase.step_s)
        assert found(z) == found_causally(z, limits.outliers) == []


@pytest.mark.parametrize(
    ("name", "damaged"),
    [
        ("z", np.zeros(3)),
        ("elapsed", -np.ones(3)),
        ("codes", np.zeros(5)),
        ("returned", np.zeros(1)),
        ("returned", [7]),
    ],
)
def test_rows_that_wait_and_are_not_those_of_a_lag_are_refused(name: str, damaged: object) -> None:
    limits = Limits(outliers=find_outlier_rule(noise()))
    ahead = LookAhead(limits, 3)
    ahead.push(noise(rows=5), np.ones(5))
    with pytest.raises(ModelError, match="waiting rows"):
        LookAhead(limits, 3).load_state_dict(ahead.state_dict() | {f"ahead_{name}": damaged})
