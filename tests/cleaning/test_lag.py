"""A recording cleaned with a lag: in the recipe, in the report, live the same, and what a delay buys."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from becalm.cleaning.delays import delays
from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.recipe import Origin, Recipe
from becalm.cleaning.recipes.steps import in_steps, lag_in_rows
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.online import Online
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording
from becalm.errors import RecipeError, UsageError

RATE_HZ = 100.0
LAG_S = 0.05


@pytest.fixture(scope="module")
def recording() -> Recording:
    rng = np.random.default_rng(6)
    return Recording(np.cumsum(0.1 * rng.normal(size=3000)) + rng.normal(size=3000), rate_hz=RATE_HZ)


@pytest.fixture(scope="module")
def recipe(recording: Recording) -> Recipe:
    """Tuned, with the sigma of the filter alone."""
    found = tune(recording, wishes=Wishes(lag_s=LAG_S))
    alone = tuple(channel.model_copy(update={"tuning_spread": 0.0}) for channel in found.channel)
    return found.model_copy(update={"channel": alone})


def test_a_recipe_keeps_its_lag(recording: Recording, recipe: Recipe) -> None:
    assert (recipe.mode, recipe.lag_s) == ("lagged", LAG_S)
    again = Recipe.from_toml(recipe.to_toml())
    assert again == recipe
    assert np.array_equal(clean(recording, again).signal.samples, clean(recording, lag_s=LAG_S).signal.samples)


@pytest.mark.parametrize(("lag_s", "causal"), [(0.03, True), (0.04, False)])
def test_a_short_lag_is_tuned_as_a_filter_a_longer_one_as_a_smoother(
    recording: Recording, lag_s: float, causal: bool
) -> None:
    assert tune(recording, wishes=Wishes(lag_s=lag_s)).channel == tune(recording, causal=causal).channel


def test_a_file_is_the_stream_so_much_later(recording: Recording, recipe: Recipe) -> None:
    out, motion = clean(recording, recipe), recipe.channel[0].motion
    assert motion is not None
    tuning = in_steps(motion, 1 / RATE_HZ)
    online = Online(tuning.component.to_model(1.0, tuning.noise_variance), lag_in_rows(LAG_S, 1 / RATE_HZ))
    told, last = online.run(recording.samples[:, 0]), online.finish()
    np.testing.assert_allclose(np.vstack([told[0][5:], last[0]]), out.signal.samples, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(np.vstack([told[1][5:], last[1]]), out.sigma.samples, rtol=1e-12)
    assert out.reports[0].delay_s == pytest.approx(LAG_S)
    assert out.reports[0].lag_s is None


def test_spikes_are_left_out_as_a_causal_filter_does(recipe: Recipe) -> None:
    """What a lag tells is then better than what the causal filter does, and far from what spikes would make of it."""
    rng = np.random.default_rng(8)
    truth, bad = np.cumsum(0.1 * rng.normal(size=3000)), rng.random(3000) < 0.02
    spiked = Recording(truth + rng.normal(size=3000) + np.where(bad, 12.0, 0.0), rate_hz=RATE_HZ)
    free = recipe.model_copy(update={"channel": (recipe.channel[0].model_copy(update={"gate": None}),)})
    assert recipe.channel[0].gate is not None
    lagged, causal, spoilt = clean(spiked, recipe), clean(spiked, recipe, causal=True), clean(spiked, free)
    verdicts = lagged.verdicts["channel_0"]
    assert np.mean((verdicts == Verdict.SPIKE) == bad) > 0.999
    assert np.array_equal(verdicts, causal.verdicts["channel_0"])
    assert lagged.reports[0].verdicts["spike"] == np.count_nonzero(verdicts == Verdict.SPIKE)
    error, filtered, believed = (np.std(out.signal.samples[:, 0] - truth) for out in (lagged, causal, spoilt))
    assert error < 0.95 * filtered
    assert error < 0.7 * believed


def test_one_recipe_leaves_less_the_longer_it_waits(recording: Recording, recipe: Recipe) -> None:
    """And sigma in the middle of the record is the one that the curve foretells, of a filter that settles by then."""
    kinematic = tuple(channel.model_copy(update={"damped_below_hz": None}) for channel in recipe.channel)
    recipe = recipe.model_copy(update={"channel": kinematic})
    (curve,) = delays(recipe).values()
    assert curve[0].wait_s == 0.0
    assert [one.left_db for one in curve] == sorted((one.left_db for one in curve), reverse=True)
    for one in curve[1:]:
        assert clean(recording, recipe, lag_s=one.wait_s).sigma.samples[1500, 0] == pytest.approx(one.sigma, rel=1e-6)
    assert clean(recording, recipe, causal=True).sigma.samples[1500, 0] == pytest.approx(curve[0].sigma, rel=1e-6)
    smoothed = clean(recording, recipe, causal=False).sigma.samples[1500, 0]
    assert 0 <= 20 * np.log10(curve[-1].sigma / smoothed) <= 0.1
    noise_std = recipe.channel[0].noise_std
    assert noise_std is not None
    assert curve[0].left_db == pytest.approx(20 * np.log10(curve[0].sigma / noise_std), abs=1e-9)


def test_a_lag_counts_the_readings_that_come_within_it() -> None:
    assert [lag_in_rows(lag_s, 0.01) for lag_s in (0.01, 0.03, 0.0399, 0.04)] == [1, 3, 3, 4]
    for lag_s in (0.005, 0.0, -1.0, float("nan"), 1e9):
        with pytest.raises(UsageError, match="or use a causal filter or a smoother"):
            lag_in_rows(lag_s, 0.01)
    with pytest.raises(UsageError, match=r"is 1e\+302 readings"):
        lag_in_rows(1e300, 0.01)


def test_a_causal_filter_has_no_lag_to_wait(recording: Recording, recipe: Recipe) -> None:
    for given in (None, recipe):
        with pytest.raises(UsageError, match="uses no later reading"):
            clean(recording, given, causal=True, lag_s=LAG_S)


@pytest.mark.parametrize("said", ['mode = "lagged"', 'mode = "causal"\nlag_s = 0.1'])
def test_a_lag_and_its_mode_belong_together(said: str, recipe: Recipe) -> None:
    text = recipe.to_toml().replace(f'mode = "lagged"\nlag_s = {LAG_S}', said)
    with pytest.raises(RecipeError, match="belong together; give both, or neither"):
        Recipe.from_toml(text)


def test_what_never_settles_has_no_curve(recipe: Recipe) -> None:
    still = recipe.channel[0].model_copy(update={"process_noise_density": 0.0})
    assert delays(Recipe(tuned_on=Origin(rate_hz=RATE_HZ), channel=(still,))) == {}


def test_a_long_lag_is_judged_as_a_smoother_is() -> None:
    rng = np.random.default_rng(8)
    x = sosfiltfilt(butter(8, 6.0, fs=200.0, output="sos"), rng.normal(size=8000))
    recording = Recording(x / x.std() + 0.05 * rng.normal(size=8000), rate_hz=200.0)
    recipe = tune(recording)
    smoothed, lagged, causal = (
        clean(recording, recipe, **how).reports[0] for how in ({}, {"lag_s": 1.0}, {"causal": True})
    )
    assert smoothed.describes
    assert lagged.verdict == smoothed.verdict
    assert causal.verdict != smoothed.verdict
