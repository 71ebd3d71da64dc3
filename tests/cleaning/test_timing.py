"""Jitter of the sampling clock is noise where the signal moves: with it sigma holds there, without it it does not."""

from __future__ import annotations

import numpy as np
import pytest

import becalm
from becalm.cleaning.channels.slopes import Slopes, TimingNoise
from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.recipes.recipe_parts import TimingRecipe
from becalm.cleaning.tuning import Wishes, time_std_of, tune, with_timing
from becalm.core.arrays import Booleans, Floats
from becalm.core.rows import EstimatedRows
from becalm.core.time.timebase import Timebase

RATE_HZ, COUNT, JITTER_S = 200.0, 6000, 1e-3
EVEN = np.arange(COUNT) / RATE_HZ


def swing(times_s: Floats) -> Floats:
    return np.asarray(np.sin(2 * np.pi * times_s) * (1 + 0.3 * np.sin(2 * np.pi * 0.13 * times_s)))


def sampled(seed: int, times_s: Floats = EVEN) -> becalm.Recording:
    """Readings taken a little early or late, which their times do not tell."""
    rng = np.random.default_rng(seed)
    readings = swing(times_s + rng.normal(0.0, JITTER_S, COUNT)) + rng.normal(0.0, 0.002, COUNT)
    return (
        becalm.Recording(readings, rate_hz=RATE_HZ) if times_s is EVEN else becalm.Recording(readings, times_s=times_s)
    )


def steep() -> Booleans:
    slopes = np.abs(np.gradient(swing(EVEN), EVEN))
    return np.asarray(slopes > 0.8 * slopes.max())


def covered(recording: becalm.Recording, recipe: Recipe) -> Booleans:
    out = becalm.clean(recording, recipe)
    return np.asarray(np.abs(out.signal.samples[:, 0] - swing(EVEN)) <= out.sigma.samples[:, 0])


def test_sigma_holds_on_slopes_with_the_jitter_and_not_without() -> None:
    with_it, without = [], []
    for seed in range(3):
        recording = sampled(seed)
        plain = tune(recording)
        with_it.append(covered(recording, tune(recording, wishes=Wishes(time_std_s=JITTER_S)))[steep()].mean())
        without.append(covered(recording, plain)[steep()].mean())
    assert np.mean(without) < 0.6  # of 0.68
    assert 0.65 < np.mean(with_it) < 0.82  # the whole error of each time, unaveraged, would cover all


def test_the_noise_that_the_jitter_made_is_not_counted_twice() -> None:
    recording = sampled(1)
    (channel,) = tune(recording, wishes=Wishes(time_std_s=JITTER_S)).channel
    assert channel.timing is not None
    slopes = np.gradient(swing(EVEN), EVEN)
    assert channel.timing.included_std == pytest.approx(JITTER_S * np.sqrt(np.mean(slopes**2)), rel=0.03)
    rest = with_timing(tune(recording), recording, JITTER_S, at_rest=True).channel[0].timing
    assert rest == TimingRecipe(std_s=JITTER_S, included_std=0.0)


def test_the_signal_is_the_same_and_sigma_never_less() -> None:
    recording = sampled(2)
    plain, told = (becalm.clean(recording, tune(recording, wishes=Wishes(time_std_s=std))) for std in (0.0, JITTER_S))
    np.testing.assert_array_equal(plain.signal.samples, told.signal.samples)
    wider = told.sigma.samples / plain.sigma.samples
    assert wider.min() == 1.0
    (report,) = told.reports
    assert report.timing_share == pytest.approx(wider.max() - 1.0)
    assert f"An uncertainty of 1e+03 us in time increases sigma by up to {wider.max() - 1.0:.1%}." in report.says
    assert plain.reports[0].timing_share is None


def test_chunks_and_a_recipe_from_its_text_give_the_same_bits() -> None:
    recording = sampled(3)
    recipe = tune(recording, causal=True, wishes=Wishes(time_std_s=JITTER_S))
    whole = becalm.clean(recording, recipe).sigma.samples[:, 0]
    elapsed, z = recording.timebase.elapsed_steps, np.ascontiguousarray(recording.samples[:, 0])
    parts = [slice(at, at + 768) for at in range(0, COUNT, 768)]
    with Cleaner(Recipe.from_toml(recipe.to_toml()), recording.timebase.step_s) as cleaner:
        told = [rows for part in parts for rows in cleaner.push([z[part]], elapsed[part])] + cleaner.finish()
    np.testing.assert_array_equal(np.concatenate([rows[0].sigma for rows in told]), whole)


@pytest.mark.parametrize("late", [0, 1, 100, 701])
def test_rows_that_are_told_later_meet_their_own_times(late: int) -> None:
    rng = np.random.default_rng(5)
    elapsed, signal = rng.uniform(0.5, 1.5, COUNT), np.cumsum(rng.normal(size=COUNT))
    rows = EstimatedRows(signal, np.ones(COUNT), np.empty((0, COUNT)), np.zeros(COUNT, np.int8))
    timing = TimingRecipe(std_s=0.01)
    whole, cut = TimingNoise(timing, 0.1, 0.5), TimingNoise(timing, 0.1, 0.5)
    whole.push(elapsed)
    sigma, at = [], 0
    for end in range(97, COUNT + 97, 97):
        cut.push(elapsed[end - 97 : end])
        stop = max(at, end - late) if end < COUNT else COUNT
        sigma.append(cut.widened(rows.rows(slice(at, stop))).sigma)
        at = stop
    slopes = np.diff(signal) / (0.5 * elapsed[1:])
    expected = np.sqrt(1 + (slopes * 0.01 / 0.1) ** 2)
    np.testing.assert_array_equal(np.concatenate(sigma), whole.widened(rows).sigma)
    np.testing.assert_allclose(np.concatenate(sigma)[1:], expected, rtol=1e-12)
    assert cut.largest_share == pytest.approx(expected.max() - 1)


def test_slopes_go_on_over_cuts_repeats_and_what_is_unknown() -> None:
    signal = np.array([np.nan, 1.0, 2.0, 4.0, 4.5, np.nan, 7.0, 8.0])
    elapsed = np.array([0.0, 1.0, 1.0, 2.0, 0.0, 1.0, 1.0, 0.5])
    whole = Slopes(0.5).of(signal, elapsed)
    np.testing.assert_array_equal(whole, [0.0, 0.0, 2.0, 2.0, 2.0, 2.0, 2.0, 4.0])
    for cut in range(len(signal) + 1):
        slopes = Slopes(0.5)
        parts = [slopes.of(signal[:cut], elapsed[:cut]), slopes.of(signal[cut:], elapsed[cut:])]
        np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_the_last_digit_of_stamps_counts_only_where_they_are_used() -> None:
    rng = np.random.default_rng(1)
    uneven = np.sort(EVEN + rng.uniform(-0.4, 0.4, COUNT) / RATE_HZ)
    assert time_std_of(Timebase.from_stamps(np.round(uneven, 3))) == pytest.approx(1e-3 / np.sqrt(12))
    assert time_std_of(Timebase.from_stamps(np.round(uneven, 7))) == 0.0
    assert time_std_of(Timebase.from_stamps(np.round(np.arange(COUNT) / 97.0, 3))) == 0.0
    assert time_std_of(Timebase.even(COUNT, RATE_HZ)) == 0.0
    rounded = becalm.Recording(sampled(4, uneven).samples, times_s=np.round(uneven, 3))
    (channel,) = tune(rounded).channel
    assert channel.timing is not None
    assert channel.timing.std_s == pytest.approx(1e-3 / np.sqrt(12))
