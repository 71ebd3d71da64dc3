"""A channel whose filter switches: its recipe, and what is told of it."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.cleaning.modes import modes_in_seconds, modes_in_steps
from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipe import Recipe
from becalm.cleaning.steps import in_steps
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.recording import Recording
from becalm.errors import RecipeError, UsageError
from becalm.noise.switching import Switched

RATE_HZ = 200.0


@pytest.fixture(scope="module")
def recording() -> Recording:
    rng = np.random.default_rng(1)
    truth = np.repeat(4 * rng.normal(size=10), 600)
    return Recording(truth + rng.normal(size=6000), names=["a"], units=["V"], rate_hz=RATE_HZ)


@pytest.fixture(scope="module")
def recipe(recording: Recording) -> Recipe:
    return tune(recording, causal=True)


def test_a_recipe_keeps_its_modes(recording: Recording, recipe: Recipe) -> None:
    (channel,) = recipe.channel
    assert channel.switching is not None
    assert channel.gate is None
    assert [mode.name for mode in channel.switching.mode] == ["still", "gentle", "quick", "abrupt"]
    again = Recipe.from_toml(recipe.to_toml())
    assert again == recipe
    one, two = clean(recording, recipe), clean(recording, again)
    assert np.array_equal(one.signal.samples, two.signal.samples)
    assert np.array_equal(one.sigma.samples, two.sigma.samples)


def test_modes_come_back_from_seconds(recipe: Recipe) -> None:
    (channel,) = recipe.channel
    assert channel.switching is not None
    assert channel.motion is not None
    tuning = in_steps(channel.motion, 1 / RATE_HZ)
    switching = modes_in_steps(channel.switching, tuning, 1 / RATE_HZ)
    told = modes_in_seconds(Switched(channel.switching.kind, switching, 0.0, 0.0), 1 / RATE_HZ)
    for one, other in zip(told.mode, channel.switching.mode, strict=True):
        own, same = one.model_dump(), other.model_dump()
        for name, value in own.items():
            assert value == (pytest.approx(same[name], rel=1e-12) if isinstance(value, float) else same[name])


def test_the_report_tells_how_long_each_mode_was_in_force(recording: Recording, recipe: Recipe) -> None:
    (report,) = clean(recording, recipe).reports
    assert sum(report.modes.values()) == pytest.approx(1.0)
    assert report.modes["still"] > 0.8
    assert report.bandwidth_hz is None
    assert report.lag_s is None


def test_split_tells_the_probability_of_each_mode(recording: Recording, recipe: Recipe) -> None:
    out = clean(recording, recipe, split=True)
    assert out.parts is not None
    names = ["a_motion", *(f"a_probability_{mode}" for mode in ("still", "gentle", "quick", "abrupt"))]
    assert list(out.parts.names) == names
    np.testing.assert_allclose(out.parts.samples[:, 1:].sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(out.parts.samples[:, 0], out.signal.samples[:, 0], rtol=1e-9, atol=1e-9)


def test_modes_that_make_no_filter_are_refused(recording: Recording, recipe: Recipe) -> None:
    (channel,) = recipe.channel
    assert channel.switching is not None
    first = channel.switching.mode[0].model_copy(update={"then": "nowhere"})
    broken = channel.switching.model_copy(update={"mode": (first, *channel.switching.mode[1:])})
    wrong = recipe.model_copy(update={"channel": (channel.model_copy(update={"switching": broken}),)})
    with pytest.raises(RecipeError, match="nowhere"):
        clean(recording, wrong)


@pytest.mark.parametrize("density", [1e100, 1e200])
def test_modes_beyond_reach_are_refused(recording: Recording, recipe: Recipe, density: float) -> None:
    (channel,) = recipe.channel
    assert channel.switching is not None
    assert channel.motion is not None
    wild = channel.switching.mode[0].model_copy(update={"order": 3, "process_noise_density": density})
    with pytest.raises(RecipeError, match="out of reach"):
        modes_in_steps(channel.switching.model_copy(update={"mode": (wild,)}), in_steps(channel.motion, 0.005), 0.005)


def test_a_lag_with_modes_is_refused(recording: Recording, recipe: Recipe) -> None:
    smoothed = recipe.model_copy(update={"mode": "smoothed"})
    with pytest.raises(UsageError, match="switches"):
        clean(recording, smoothed, lag_s=0.1)


def test_a_robust_filter_is_asked_for_alone(recording: Recording) -> None:
    with pytest.raises(UsageError, match="robust"):
        tune(recording, wishes=Wishes(robust=True, removed_hz=(50.0,)))
    (channel,) = tune(recording, wishes=Wishes(robust=True)).channel
    assert channel.switching is not None
    assert channel.switching.kind == "spiky"
