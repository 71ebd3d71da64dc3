"""The last sentinel: an estimate that left everything that was read is not told, in file and stream alike."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import becalm
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.core.arrays import Floats
from becalm.core.health.limits import Limits
from becalm.core.health.outlier_rule import Outliers
from becalm.core.health.sentinel import Sentinel
from becalm.core.reading_verdicts import Verdict
from becalm.core.rows import EstimatedRows
from becalm.errors import RecipeError

LIMITS = Limits(outliers=Outliers(low=-10.0, high=10.0))
ROWS, RATE_HZ = 600, 100.0


def told(signal: Floats, verdicts: Floats) -> EstimatedRows:
    return EstimatedRows(signal, np.ones(len(signal)), np.empty((0, len(signal))), verdicts.astype(np.int8))


@given(st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60), st.booleans()), max_size=40), st.integers(0, 40))
def test_an_estimate_is_told_where_it_is_plausible_or_near_what_was_read(
    rows: list[tuple[float, float, bool]], cut: int
) -> None:
    signal, readings, missing = np.array(rows, float).reshape(-1, 3).T
    readings = np.where(missing > 0, np.nan, readings)
    watch, found = Sentinel(LIMITS), []
    watch.push(readings)
    for part in (slice(None, cut), slice(cut, None)):
        found.append(watch.mark_implausible(told(signal[part], missing[part])))
        saved = watch.state_dict()
        watch = Sentinel(LIMITS)
        watch.load_state_dict(saved)
    last, verdicts = np.nan, np.concatenate([part.verdicts for part in found])
    for k, estimate in enumerate(signal):
        last = last if np.isnan(readings[k]) else readings[k]
        away = abs(estimate) > 10 and abs(estimate - last) > 20
        assert (verdicts[k] == Verdict.RUNAWAY) == away
        assert np.isnan(np.concatenate([part.signal for part in found])[k]) == away


@given(st.lists(st.tuples(st.floats(0.5, 1.5), st.sampled_from([0, 0, 1, 4, 6])), max_size=40), st.integers(0, 40))
def test_a_hole_begins_with_its_second_row_or_the_first_of_all(rows: list[tuple[float, int]], cut: int) -> None:
    sigma, verdicts = np.array(rows, float).reshape(-1, 2).T
    all_rows = EstimatedRows(np.zeros(len(sigma)), sigma, np.empty((0, len(sigma))), verdicts.astype(np.int8))
    watch, found = Sentinel(LIMITS, hole_sigma=1.0), []
    watch.push(np.where(verdicts > 0, np.nan, 0.0))
    for part in (slice(None, cut), slice(cut, None)):
        found.append(watch.mark_implausible(all_rows.rows(part)))
        saved = watch.state_dict()
        watch = Sentinel(LIMITS, hole_sigma=1.0)
        watch.load_state_dict(saved)
    told = np.concatenate([part.verdicts for part in found])
    for k in range(len(sigma)):
        missing = [verdicts[row] in (Verdict.MISSING, Verdict.CLIPPED) for row in (k - 1, k) if row >= 0]
        assert (told[k] == Verdict.HOLE) == (all(missing) and sigma[k] >= 1.0)


def test_a_hole_goes_on_behind_an_estimate_that_ran_away() -> None:
    verdicts = np.array([Verdict.USED, Verdict.MISSING, Verdict.MISSING, Verdict.MISSING], np.int8)
    rows = EstimatedRows(np.array([0.0, 1.0, 60.0, 9.0]), np.full(4, 2.0), np.empty((0, 4)), verdicts)
    for cut in range(5):
        watch = Sentinel(LIMITS, hole_sigma=1.0)
        watch.push(np.array([0.0, np.nan, np.nan, np.nan]))
        found = [watch.mark_implausible(rows.rows(part)).verdicts for part in (slice(None, cut), slice(cut, None))]
        assert np.concatenate(found).tolist() == [Verdict.USED, Verdict.MISSING, Verdict.RUNAWAY, Verdict.HOLE]


def runaway_recipe() -> Recipe:
    """Return a recipe, as a person may write one, whose estimate runs away where no readings come."""
    return Recipe.from_toml("""
becalm_recipe = 5
mode = "causal"
tuned_on.rate_hz = 100.0
[[channel]]
name = "a"
model = "motion"
order = 3
process_noise_density = 1e3
noise_std = 0.01
[channel.limits]
outlier_distance = 50.0
causal_outlier_distance = 50.0
plausible_low = -30.0
plausible_high = 30.0
""")


def shaken() -> Floats:
    z = np.sin(np.arange(ROWS) / 8.0) + 0.01 * np.random.default_rng(1).normal(size=ROWS)
    z[200:400] = np.nan
    return z


@pytest.mark.parametrize("lag_s", [None, 0.05])
def test_a_runaway_is_no_estimate_and_is_said(lag_s: float | None) -> None:
    z, recipe = shaken(), runaway_recipe()
    out = becalm.clean(becalm.Recording(z, names=["a"], rate_hz=RATE_HZ), recipe, lag_s=lag_s)
    signal, away = out.signal.samples[:, 0], out.verdicts["a"] == Verdict.RUNAWAY
    assert 20 < away.sum() < 200
    assert away[200:400].sum() == away.sum()
    assert np.isnan(signal[away]).all()
    assert np.nanmax(np.abs(signal)) <= 62.0
    assert "far outside the range of all readings" in out.reports[0].says
    mode = {} if lag_s is None else {"mode": "lagged", "lag_s": lag_s}
    stream = StreamCleaner(recipe.model_copy(update=mode), 1 / RATE_HZ)
    parts = [stream.push(z[at : at + 70, np.newaxis], np.ones(len(z[at : at + 70]))) for at in range(0, ROWS, 70)]
    if lag_s is not None:
        parts.append(stream.finish())
    verdicts = np.concatenate([part.verdicts for part in parts])[:, 0]
    np.testing.assert_array_equal(verdicts == Verdict.RUNAWAY, away)


def test_where_readings_go_on_far_away_the_estimate_goes_with_them() -> None:
    z = shaken()
    z[200:400] = 0.0
    z[400:] += 500.0
    out = becalm.clean(becalm.Recording(z, names=["a"], rate_hz=RATE_HZ), runaway_recipe())
    assert (out.verdicts["a"] == Verdict.RUNAWAY).sum() <= 5
    assert np.nanmax(np.abs(out.signal.samples[450:, 0] - z[450:])) < 1.0


def test_a_reversed_plausible_range_is_refused() -> None:
    with pytest.raises(RecipeError, match="plausible_low is not below plausible_high"):
        Recipe.from_toml(runaway_recipe().to_toml().replace("plausible_low = -30.0", "plausible_low = 40.0"))


def test_a_stream_reads_no_value_that_a_mask_hides() -> None:
    z = np.ma.masked_array(shaken()[:100, np.newaxis], mask=np.arange(100)[:, np.newaxis] == 60)
    hidden, missing = (
        StreamCleaner(runaway_recipe(), 1 / RATE_HZ).push(rows, np.ones(100)) for rows in (z, z.filled(np.nan))
    )
    assert hidden.verdicts[60, 0] == Verdict.MISSING
    np.testing.assert_array_equal(hidden.signal, missing.signal)
