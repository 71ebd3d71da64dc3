"""Faults on a channel's way: the same wherever the rows are cut, in every flow, and no digit where there are none."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from becalm.cleaning.channels.faults import SensorWatch, find_healthy
from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.limits_entry import limits_of, outlier_test_rows
from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import LimitsRecipe
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats
from becalm.core.health.limits import Limits
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording
from becalm.core.rows import EstimatedRows

RATE_HZ, ROWS = 100.0, 6000


def walk(seed: int, rows: int = ROWS) -> Floats:
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(0, 0.05, rows)) + rng.normal(size=rows)


def faulty() -> Floats:
    z = walk(1)
    z[2000:2400] = z[2000]
    z[3000], z[3001] = np.nan, np.inf
    return z


def recording(z: Floats) -> Recording:
    return Recording(z, rate_hz=RATE_HZ)


def test_stuck_readings_are_no_readings_in_tuning_and_cleaning() -> None:
    """The same as where a person had taken them out."""
    z = faulty()
    out = clean(recording(z))
    stuck = out.verdicts["channel_0"] == Verdict.STUCK
    assert stuck.sum() > 380
    without = clean(recording(np.where(stuck, np.nan, z)), out.recipe)
    assert np.array_equal(out.signal.samples, without.signal.samples)
    assert np.array_equal(out.sigma.samples, without.sigma.samples)
    assert out.recipe.channel[0].noise_std == pytest.approx(1.0, rel=0.05)


MODES: dict[str, dict[str, object]] = {
    "smoothed": {},
    "causal": {"mode": "causal"},
    "lagged": {"mode": "lagged", "lag_s": 0.1},
}


@pytest.mark.parametrize("mode", MODES)
def test_any_cuts_give_the_same_rows_and_the_same_report(mode: str) -> None:
    z, elapsed = np.tile(faulty(), 2), np.ones(2 * ROWS)
    elapsed[0], elapsed[4500], elapsed[4600] = 0.0, 7.0, 0.0
    channel = tune(recording(faulty())).channel[0]
    assert channel.limits is not None
    alarms = channel.limits.model_copy(update={"drift_threshold": 3.0, "dead_variance": 0.5})
    unchanged = ChannelRecipe(name="same", model="untold", limits=LimitsRecipe(high=1.0, stuck_readings=9))
    recipe = Recipe(
        tuned_on=Origin(rate_hz=RATE_HZ), channel=(channel.model_copy(update={"limits": alarms}), unchanged)
    ).model_copy(update=MODES[mode])
    told = []
    for cuts in ([], [256 * k for k in range(1, 40, 3)]):
        with Cleaner(recipe, 1 / RATE_HZ) as cleaner:
            answers = [
                answer
                for rows in np.split(np.arange(len(z)), cuts)
                for answer in cleaner.push([z[rows], z[rows]], elapsed[rows])
            ]
            answers += cleaner.finish()
            told.append(([joined([answer[k] for answer in answers]) for k in (0, 1)], cleaner.reports()))
    (whole, reports), (cut, cut_reports) = told
    for one, other in zip(whole, cut, strict=True):
        assert np.array_equal(one.verdicts, other.verdicts)
        atol = 1e-12 if mode == "smoothed" else 0.0  # a smoother lets what is far ahead be forgotten
        np.testing.assert_allclose(one.signal, other.signal, rtol=0, atol=atol)
    assert {Verdict.STUCK, Verdict.GAP, Verdict.REPEATED, Verdict.DRIFT} <= set(whole[0].verdicts.tolist())
    for report, other_report in zip(reports, cut_reports, strict=True):
        assert (report.faults, report.advice, report.verdicts) == (
            other_report.faults,
            other_report.advice,
            other_report.verdicts,
        )
    gap = reports[0].faults[-1]
    assert (gap.what, gap.first_row) == ("gap", 4501)
    assert gap.first_s == pytest.approx(45.06)


def joined(parts: list[EstimatedRows]) -> EstimatedRows:
    return EstimatedRows(*(np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True)))


@pytest.mark.parametrize(
    "z",
    [
        walk(2),
        np.full(500, 3.0),
        np.sign(np.sin(np.arange(4000) / 100)),
        np.round(walk(3)),
        np.maximum(0.0, 30 * np.sin(np.arange(4000) / 350) + 0.1 * walk(4, 4000)),
    ],
    ids=["walk", "constant", "square wave", "coarse", "stops of a car"],
)
def test_healthy_readings_come_back_as_they_are(z: Floats) -> None:
    elapsed = np.ones(len(z))
    found = find_healthy(z, elapsed, 0.01)
    assert found.readings is z
    watch = SensorWatch(found.limits, 0.01)
    assert watch.push(z, elapsed)[0] is z
    assert watch.findings.faults() == ()


def test_a_car_that_stops_for_the_first_time_is_not_stuck() -> None:
    """Speeds rest at 0, where the recipe's record had no stop; a strain gauge that reads it for long is stuck."""
    watch = SensorWatch(LimitsRecipe(stuck_readings=5), 0.01)
    z = np.append(np.linspace(20, 0.1, 200), np.zeros(300))
    assert watch.push(z, np.ones(len(z)))[0] is z
    watch = SensorWatch(LimitsRecipe(stuck_readings=5), 0.01)
    assert np.isnan(watch.push(np.append(-1.0, z), np.ones(len(z) + 1))[0]).sum() == 296


def test_most_readings_lost_is_said_first() -> None:
    z = walk(5, 1000)
    z[300:] = z[300]
    watch = SensorWatch(LimitsRecipe(stuck_readings=10), 0.01)
    watch.push(z, np.ones(1000))
    assert watch.findings.says()[0].startswith("691 of 1000 readings are clipped or stuck")


def test_limits_go_through_a_recipe_and_come_back() -> None:
    limits = LimitsRecipe(low=-5.0, high=5.0, resolution=0.5, stuck_readings=7, even_time=True, gap_steps=2.5)
    assert limits_of(limits) == Limits(-5.0, 5.0, 0.5, 7, 2.5, True)
    assert limits_of(None) == Limits(even=False)
    recipe = Recipe(tuned_on=Origin(rate_hz=1.0), channel=(ChannelRecipe(name="a", model="constant", limits=limits),))
    assert Recipe.from_toml(recipe.to_toml()) == recipe


def test_drift_and_death_are_told_of_a_later_record_only() -> None:
    healthy = recording(walk(6, 20_000))
    recipe = tune(healthy, causal=True)
    limits = recipe.channel[0].limits
    assert limits is not None
    assert limits.drift_threshold is not None
    assert clean(healthy, recipe).reports[0].faults == ()
    rng, later = np.random.default_rng(8), walk(9, 20_000)
    later[10_000:] = later[10_000] + rng.normal(0, 0.01, 10_000)
    out = clean(recording(later), recipe)
    (dead,) = out.reports[0].faults
    assert dead.what == "dead"
    assert 10_000 < dead.first_row < 10_000 + 100 * dead.found_within_s + 200
    assert np.count_nonzero(out.verdicts["channel_0"] == Verdict.DEAD) == dead.readings > 9000
    ramp = walk(10, 20_000) + 0.04 * np.maximum(np.arange(20_000) - 10_000, 0)
    (drift,) = clean(recording(ramp), recipe).reports[0].faults
    assert drift.what == "drift"
    assert 10_000 < drift.first_row < 12_000


def test_noise_that_doubles_is_told_with_when() -> None:
    rng = np.random.default_rng(11)
    z = np.cumsum(rng.normal(0, 0.05, ROWS)) + rng.normal(size=ROWS) * np.where(np.arange(ROWS) < 2500, 1.0, 2.0)
    (report,) = clean(recording(z)).reports
    (sentence,) = [one for one in report.advice if "the noise is" in one]
    assert float(sentence.split()[1]) == pytest.approx(25.0, abs=1.28)
    assert float(sentence.split()[7]) == pytest.approx(2.0, rel=0.1)
    assert sentence in report.says


def test_what_a_caller_writes_later_into_its_own_array_moves_no_time() -> None:
    watch, elapsed, nu = SensorWatch(LimitsRecipe(drift_threshold=5.0), 1.0), np.ones(50), np.zeros(100)
    nu[60:] = 3.0
    elapsed[5] = 1000.0
    watch.push(walk(13, 50), elapsed)
    elapsed[5] = 1.0
    watch.push(walk(14, 50), elapsed)
    watch.add_innovations(nu, np.ones(100))
    drift = watch.findings.faults()[0]
    assert drift.what == "drift"
    assert drift.first_s == drift.first_row - 1 + 999


def test_a_dial_or_a_lag_keeps_the_limits() -> None:
    lagged = tune(recording(walk(12)), wishes=Wishes(lag_s=0.05)).channel[0].limits
    assert lagged is not None
    assert lagged.stuck_readings is not None


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("low", [-999.0, 4.0])
def test_what_is_left_out_too_often_to_be_an_exception_is_not_described(low: float, causal: bool) -> None:
    """A level that a channel rests at cannot be told from what is written for nothing, unless it is 0."""
    z = 12.0 + 0.02 * np.random.default_rng(0).normal(size=4000)
    z[:30], z[1000:1200] = low, low
    few = clean(Recording(z, rate_hz=100.0), causal=causal)
    z[2000:2500] = low
    many = clean(Recording(z, rate_hz=100.0), causal=causal)
    assert few.describes
    assert not many.describes
    assert "730 of 4000 readings were left out" in many.reports[0].says


def test_a_smoother_without_a_distance_of_its_own_finds_no_outlier() -> None:
    """That of a causal filter, which a recipe may have beside it, is none of its."""
    z = np.random.default_rng(0).normal(size=400)
    z[200] = 1e3
    watch = SensorWatch(LimitsRecipe(causal_outlier_distance=30.0), 0.01, ahead=outlier_test_rows(None, None))
    assert watch.push(z, np.ones(400))[0] is z


def test_a_recipe_that_does_not_tell_leaves_out_a_0_far_from_what_it_knows() -> None:
    told = LimitsRecipe(
        outlier_distance=30.0,
        causal_outlier_distance=60.0,
        plausible_low=0.0,
        plausible_high=72.0,
        repeats_are_one=True,
    )
    assert limits_of(told).outliers.far_from_0 == 2.0
    assert limits_of(told.model_copy(update={"far_from_0": 0.0})).outliers.far_from_0 == 0.0
    assert limits_of(told.model_copy(update={"repeats_are_one": None})).outliers.far_from_0 == 0.0
    assert (
        limits_of(
            told.model_copy(update={"outlier_distance": None, "causal_outlier_distance": None})
        ).outliers.far_from_0
        == 0.0
    )
    with pytest.raises(ValidationError, match="far_from_0 came alone"):
        LimitsRecipe(far_from_0=1.0)
