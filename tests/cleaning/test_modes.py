"""A channel whose filter switches: its recipe, and what is told of it."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.cleaning.channels.figures import modes_in_seconds, modes_in_steps
from becalm.cleaning.delays import delays
from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.recipes.steps import in_steps
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats
from becalm.core.closed_forms import order_one
from becalm.core.imm.modes import InteractingModels
from becalm.core.online import Online
from becalm.core.recording import Recording
from becalm.core.steady.steady_filter import steady
from becalm.errors import RecipeError, UsageError
from becalm.metrics.truth import rms_error

RATE_HZ = 200.0


MODES = ["still", "gentle", "quick", "abrupt", "leap"]


@pytest.fixture(scope="module")
def truth() -> Floats:
    return np.repeat(4 * np.random.default_rng(1).normal(size=10), 600)


@pytest.fixture(scope="module")
def recording(truth: Floats) -> Recording:
    noise = np.random.default_rng(2).normal(size=6000)
    return Recording(truth + noise, names=["a"], units=["V"], rate_hz=RATE_HZ)


@pytest.fixture(scope="module")
def recipe(recording: Recording) -> Recipe:
    return tune(recording, causal=True)


def switching_of(recipe: Recipe) -> InteractingModels:
    """Return the modes of the only channel, in steps."""
    (channel,) = recipe.channel
    assert channel.switching is not None
    assert channel.motion is not None
    return modes_in_steps(channel.switching, in_steps(channel.motion, 1 / RATE_HZ), 1 / RATE_HZ)


def test_a_recipe_keeps_its_modes(recording: Recording, recipe: Recipe) -> None:
    (channel,) = recipe.channel
    assert channel.switching is not None
    assert channel.gate is None
    assert [mode.name for mode in channel.switching.mode] == MODES
    again = Recipe.from_toml(recipe.to_toml())
    assert again == recipe
    one, two = clean(recording, recipe), clean(recording, again)
    assert np.array_equal(one.signal.samples, two.signal.samples)
    assert np.array_equal(one.sigma.samples, two.sigma.samples)


def test_modes_come_back_from_seconds(recipe: Recipe) -> None:
    (channel,) = recipe.channel
    assert channel.switching is not None
    told = modes_in_seconds(channel.switching.kind, switching_of(recipe), 1 / RATE_HZ)
    for one, other in zip(told.mode, channel.switching.mode, strict=True):
        own, same = one.model_dump(), other.model_dump()
        for name, value in own.items():
            assert value == (pytest.approx(same[name], rel=1e-12) if isinstance(value, float) else same[name])


def test_the_report_tells_what_each_mode_is_and_how_long_it_was_in_force(recording: Recording, recipe: Recipe) -> None:
    (report,), (smooth,) = clean(recording, recipe).reports, clean(recording, recipe, causal=False).reports
    modes = list(report.modes.values())
    assert sum(mode.share for mode in modes) == pytest.approx(1.0)
    assert report.modes["still"].share > 0.8
    assert report.bandwidth_hz is None
    assert report.lag_s is None
    bandwidths, lags, left = zip(*((mode.bandwidth_hz, mode.lag_s, mode.noise_left) for mode in modes), strict=True)
    assert list(bandwidths) == sorted(bandwidths)
    assert list(left) == sorted(left)
    assert list(lags) == sorted(lags, reverse=True)
    for mode, own in zip(modes, switching_of(recipe).modes, strict=True):
        gain = order_one(own.component.noise_density[0, 0] / own.noise_variance).noise_gain
        assert mode.noise_left == pytest.approx(np.sqrt(gain * own.noise_variance), rel=1e-6)
    assert [mode.lag_s for mode in smooth.modes.values()] == [0.0] * 5


def test_what_a_delay_buys_is_told_of_each_mode(recipe: Recipe) -> None:
    curves = delays(recipe)
    assert list(curves) == ["a, still", "a, gentle", "a, quick"]
    for name, mode in zip(curves, switching_of(recipe).modes[:3], strict=True):
        model = mode.component.to_model(1.0, mode.noise_variance)
        assert curves[name][0].sigma ** 2 == pytest.approx(steady(model).error_variance(), rel=1e-9)


def test_split_tells_the_probability_of_each_mode(recording: Recording, recipe: Recipe) -> None:
    out = clean(recording, recipe, split=True)
    assert out.parts is not None
    names = ["a_motion", *(f"a_probability_{mode}" for mode in MODES)]
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


def test_a_lag_lies_between_the_filter_and_the_smoother(recording: Recording, truth: Floats, recipe: Recipe) -> None:
    causal, late, smooth = (
        clean(recording, recipe, **how) for how in ({"causal": True}, {"lag_s": 0.1}, {"causal": False})
    )
    errors = [rms_error(out.signal.samples[:, 0], truth) for out in (causal, late, smooth)]
    assert errors == sorted(errors, reverse=True)
    assert late.reports[0].delay_s == pytest.approx(0.1)
    assert late.reports[0].modes.keys() == causal.reports[0].modes.keys()


def test_modes_are_found_for_a_lag_too(recording: Recording, recipe: Recipe) -> None:
    """A short one is tuned as a filter."""
    found = tune(recording, wishes=Wishes(lag_s=0.005))
    assert found.channel == recipe.channel
    online = Online(switching_of(recipe), lag=1)
    signal, _ = online.run(recording.samples[:, 0])
    told = clean(recording, found).signal.samples
    assert np.array_equal(np.vstack([signal[1:], online.finish()[0]]), told)


@pytest.mark.parametrize("density", [1e100, 1e200])
def test_modes_beyond_reach_are_refused(recording: Recording, recipe: Recipe, density: float) -> None:
    (channel,) = recipe.channel
    assert channel.switching is not None
    assert channel.motion is not None
    wild = channel.switching.mode[0].model_copy(update={"order": 3, "process_noise_density": density})
    with pytest.raises(RecipeError, match="out of range"):
        modes_in_steps(channel.switching.model_copy(update={"mode": (wild,)}), in_steps(channel.motion, 0.005), 0.005)


def test_a_robust_filter_is_asked_for_alone(recording: Recording) -> None:
    with pytest.raises(UsageError, match="robust"):
        tune(recording, wishes=Wishes(robust=True, removed_hz=(50.0,)))
    (channel,) = tune(recording, wishes=Wishes(robust=True)).channel
    assert channel.switching is not None
    assert channel.switching.kind == "spiky"


def test_a_robust_recipe_keeps_tones_and_a_level_that_jumps() -> None:
    rng, k = np.random.default_rng(4), np.arange(6000)
    z = 5 * np.sin(0.02 * k) + rng.normal(size=6000) + 8 * (rng.random(6000) < 0.1)
    recording = Recording(z, names=["a"], units=["V"], rate_hz=RATE_HZ)
    recipe = tune(recording, causal=True, wishes=Wishes(robust=True))
    (channel,) = recipe.channel
    assert channel.switching is not None
    assert channel.motion is not None
    steady, abrupt = channel.switching.mode
    assert steady.level_noise_density == 0.0
    assert abrupt.level_noise_density == pytest.approx(channel.switching.wild_std**2 * RATE_HZ)
    assert steady.with_tones == abrupt.with_tones == bool(channel.tone)
    assert Recipe.from_toml(recipe.to_toml()) == recipe
    switching = modes_in_steps(channel.switching, in_steps(channel.motion, 1 / RATE_HZ), 1 / RATE_HZ)
    told = modes_in_seconds("spiky", switching, 1 / RATE_HZ)
    assert told.mode[1].level_noise_density == pytest.approx(abrupt.level_noise_density)


def rms(recording: Recording, samples: Floats, truth: Floats, causal: bool) -> float:
    """Clean other samples; return the rms error after the first 30 rows and away from rows that were changed."""
    out = clean(Recording(samples, rate_hz=RATE_HZ), causal=causal)
    assert out.reports[0].modes
    changed = np.flatnonzero(samples != recording.samples[:, 0])
    kept = np.ones(len(truth), bool)
    kept[:30] = False
    for row in changed if len(changed) < 10 else []:
        kept[row : row + 3] = False
    return rms_error(out.signal.samples[kept, 0], truth[kept])


@pytest.mark.parametrize(("sizes", "causal"), [((1e4, 1e7), True), ((1e2, 1e7), False)])
def test_a_first_reading_far_out_does_not_hold_levels(
    recording: Recording, truth: Floats, sizes: tuple[float, ...], causal: bool
) -> None:
    as_it_was = rms(recording, recording.samples[:, 0], truth, causal)
    for size in sizes:
        samples = recording.samples[:, 0].copy()
        samples[0] += size
        assert rms(recording, samples, truth, causal) < 1.3 * as_it_was


@pytest.mark.parametrize(("size", "causal"), [(1e2, False), (1e4, True), (1e7, True), (1e7, False)])
def test_a_level_that_leaps_as_far_as_ever_is_followed(size: float, causal: bool) -> None:
    truth = np.repeat([0.0, size], 2000)
    noise = np.random.default_rng(4).normal(size=4000)
    out = clean(Recording(truth + noise, rate_hz=RATE_HZ), causal=causal)
    off = np.abs(out.signal.samples[:, 0] - truth)
    assert out.reports[0].modes
    assert off[2004:].max() < 3.0  # of the noise: no farther than a reading
    assert np.sqrt(np.mean(off[2100:] ** 2)) < 0.2


@pytest.mark.parametrize("size", [1e3, 1e7])
def test_one_reading_far_out_is_smoothed_away(recording: Recording, truth: Floats, size: float) -> None:
    samples = recording.samples[:, 0].copy()
    samples[3300] += size
    out = clean(Recording(samples, rate_hz=RATE_HZ))
    assert abs(out.signal.samples[3300, 0] - truth[3300]) < 3.0  # of the noise
    assert out.reports[0].verdicts["outlier"] == 1


def test_a_recipe_meets_leaps_farther_than_any_it_was_tuned_on(recipe: Recipe) -> None:
    truth = np.repeat([0.0, 5e4], 1000)
    noise = np.random.default_rng(4).normal(size=2000)
    out = clean(Recording(truth + noise, names=["a"], units=["V"], rate_hz=RATE_HZ), recipe)
    assert np.abs(out.signal.samples[1004:, 0] - 5e4).max() < 3.0


@pytest.mark.parametrize("causal", [True, False])
def test_levels_with_spikes_and_a_bad_first_reading_are_levels(causal: bool) -> None:
    """A load cell with loose contacts: its spikes neither swell the noise nor hide that levels hold."""
    rng = np.random.default_rng(11)
    truth = 20 + np.repeat([0.0, 12.0, -5.0, 3.0], 1500)
    z = truth + 0.3 * rng.normal(size=6000)
    z[rng.random(6000) < 0.002] += 40.0
    z[0] = 0.0
    out = clean(Recording(z, rate_hz=200.0), causal=causal)
    (report,) = out.reports
    assert report.modes
    assert report.describes
    assert report.noise_std == pytest.approx(0.3, rel=0.1)
    away = np.abs(np.arange(6000) % 1500 - 750) < 740  # from jumps
    assert rms_error(out.signal.samples[away, 0], truth[away]) < 0.1


@pytest.mark.parametrize("causal", [True, False])
def test_the_modes_of_a_slower_sensor_are_those_of_its_own_rate(
    recording: Recording, recipe: Recipe, causal: bool
) -> None:
    seen = recording.samples[:, 0]
    repeated = Recording(np.repeat(seen, 4), names=["a"], units=["V"], rate_hz=4 * RATE_HZ)
    of_its_own = recipe if causal else tune(recording)
    own, logged = (found.channel[0].switching for found in (of_its_own, tune(repeated, causal=causal)))
    assert own is not None
    assert logged is not None
    assert logged.kind == own.kind
    for one, other in zip(logged.mode, own.mode, strict=True):
        assert one.noise_std == pytest.approx(other.noise_std, rel=1e-6)
        assert one.lasts_s == pytest.approx(other.lasts_s, rel=1e-6)
        assert one.process_noise_density == pytest.approx(other.process_noise_density, rel=1e-6)
