"""Sigma leaves with the spread of the tuning and the uncertainty of the calibration, and averaging tells them apart."""

from __future__ import annotations

import numpy as np
import pytest

import becalm
from becalm.cleaning.recipes.recipe import VERSION, Recipe
from becalm.cleaning.recipes.recipe_parts import CalibrationRecipe
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats
from becalm.identification.wishes.dial import Dial


@pytest.fixture(scope="module")
def recording() -> becalm.Recording:
    rng = np.random.default_rng(5)
    return becalm.Recording(8 + np.cumsum(0.2 * rng.normal(size=150)) + rng.normal(size=150), rate_hz=10.0)


def with_channel(recipe: Recipe, **changes: object) -> Recipe:
    return recipe.model_copy(update={"channel": (recipe.channel[0].model_copy(update=changes),)})


def sigma_of(recording: becalm.Recording, recipe: Recipe) -> Floats:
    return becalm.clean(recording, recipe).sigma.samples[:, 0]


@pytest.mark.parametrize("causal", [True, False])
def test_sigma_is_wider_by_the_spread_and_the_signal_is_the_same(recording: becalm.Recording, causal: bool) -> None:
    recipe = tune(recording, causal=causal)
    spread = recipe.channel[0].tuning_spread
    assert 0 < spread < 1
    wide, narrow = becalm.clean(recording, recipe), becalm.clean(recording, with_channel(recipe, tuning_spread=0.0))
    np.testing.assert_array_equal(wide.signal.samples, narrow.signal.samples)
    np.testing.assert_allclose(wide.sigma.samples, (1 + spread) * narrow.sigma.samples, rtol=1e-15)
    assert wide.reports[0].tuning_spread == spread


def test_the_calibration_adds_in_squares_and_is_told_apart(recording: becalm.Recording) -> None:
    recipe = tune(recording)
    calibrated = with_channel(recipe, calibration=CalibrationRecipe(relative_std=0.01, offset_std=0.03))
    random, found = sigma_of(recording, recipe), becalm.clean(recording, calibrated)
    x = found.signal.samples[:, 0]
    expected = np.sqrt(random**2 + (0.01 * x) ** 2 + 0.03**2)
    np.testing.assert_allclose(found.sigma.samples[:, 0], expected, rtol=1e-14)
    told = found.reports[0].as_dict()["calibration_std"]
    assert told == pytest.approx(np.hypot(0.01 * np.abs(x).mean(), 0.03))
    assert becalm.clean(recording, recipe).reports[0].calibration_std is None


def test_what_is_unknown_stays_unknown() -> None:
    z = np.concatenate([[np.nan, np.nan], np.sin(np.arange(100) / 9) + np.random.default_rng(1).normal(size=100)])
    recording = becalm.Recording(z, rate_hz=1.0)
    recipe = with_channel(tune(recording, causal=True), calibration=CalibrationRecipe(relative_std=0.1))
    sigma = sigma_of(recording, recipe)
    assert np.all(np.isinf(sigma[:2]))
    assert np.all(np.isfinite(sigma[3:]))


def test_what_a_person_asked_for_has_no_spread(recording: becalm.Recording) -> None:
    recipe = tune(recording, causal=True, wishes=Wishes(dial=Dial("bandwidth_hz", 0.5)))
    assert recipe.channel[0].tuning_spread == 0.0


@pytest.mark.parametrize("causal", [True, False])
def test_the_report_says_over_which_time_samples_are_one(recording: becalm.Recording, causal: bool) -> None:
    """Of order 1, sigma^2 times it is r times the step, smoothed; filtered 2 - K times as much."""
    recipe = with_channel(tune(recording, causal=causal), tuning_spread=0.0, damped_below_hz=None)
    out = becalm.clean(recording, recipe)
    (report,), sigma = out.reports, out.sigma.samples[75, 0]
    assert report.order == 1
    assert None not in (report.independence_s, report.q_over_r, report.noise_std)
    ratio = report.q_over_r or np.nan
    K = (np.sqrt(ratio**2 + 4 * ratio) - ratio) / 2
    told = sigma**2 * (report.independence_s or np.nan) / ((report.noise_std or np.nan) ** 2 * 0.1)
    assert told == pytest.approx(2 - K if causal else 1.0, rel=1e-4)


def test_a_recipe_of_older_versions_trusts_its_tuning(recording: becalm.Recording) -> None:
    text = tune(recording).to_toml()
    older = "\n".join(line for line in text.splitlines() if "tuning_spread =" not in line)
    recipe = Recipe.from_toml(older.replace(f"becalm_recipe = {VERSION}", "becalm_recipe = 3"))
    assert (recipe.becalm_recipe, recipe.channel[0].tuning_spread, recipe.channel[0].calibration) == (
        VERSION,
        0.0,
        None,
    )
