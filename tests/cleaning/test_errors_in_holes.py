"""In holes a smoother is worth what readings showed that were hidden: its share beside a line, and its sigma."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import becalm
from becalm.cleaning.channels.holes import Holes
from becalm.cleaning.errors_in_holes import LENGTHS, choose_hidden_rows
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.recipes.recipe_parts import HoleRecipe
from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.core.rows import EstimatedRows

RATE_HZ = 200.0
SHOWN = (
    HoleRecipe(readings=8, model_fading=0.2, sigma_growth=0.1),
    HoleRecipe(readings=40, model_fading=1.0, sigma_growth=0.5),
)


def told(missing: list[bool], seed: int = 0) -> EstimatedRows:
    rng, rows = np.random.default_rng(seed), len(missing)
    lost = np.array(missing, bool)
    sigma = np.where(lost, 2.0 + rng.random(rows), 1.0)
    verdicts = np.where(lost, np.int8(Verdict.MISSING), np.int8(Verdict.USED))
    parts = rng.normal(size=(2, rows))
    return EstimatedRows(parts.sum(axis=0), sigma, parts, verdicts)


def bridged(rows: EstimatedRows, cuts: list[int], shown: tuple[HoleRecipe, ...] = SHOWN) -> EstimatedRows:
    holes, found = Holes(shown, 1.0), []
    for start, stop in zip([0, *cuts], [*cuts, len(rows.signal)], strict=True):
        part = rows.rows(slice(start, stop))
        holes.push(np.ones(stop - start))
        found += holes.corrected([part])
    found += holes.finish()
    return EstimatedRows(*(np.concatenate(field, axis=-1) for field in zip(*found, strict=True)))


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.data())
@settings(max_examples=60)
def test_where_rows_are_cut_changes_no_bit(missing: list[bool], data: st.DataObject) -> None:
    cuts = sorted(data.draw(st.lists(st.integers(0, len(missing)), max_size=5)))
    rows = told(missing)
    whole, cut = bridged(rows, []), bridged(rows, cuts)
    for one, other in zip(whole, cut, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(whole.parts.sum(axis=0), whole.signal, atol=1e-12)
    used = ~np.array(missing)
    np.testing.assert_array_equal(whole.signal[used], rows.signal[used])
    np.testing.assert_array_equal(whole.sigma[used], rows.sigma[used])


def test_the_model_fades_to_a_line_and_sigma_grows() -> None:
    lost = np.zeros(60, bool)
    lost[10:50] = True
    rows = told(lost.tolist())
    found = bridged(rows, [])
    line = np.interp(np.arange(60), [9, 50], rows.signal[[9, 50]])
    expected = line + (rows.signal - line) / rows.sigma
    np.testing.assert_allclose(found.signal[lost], expected[lost])
    np.testing.assert_allclose(found.sigma[lost], rows.sigma[lost] ** 1.5)


def test_at_the_ends_of_a_record_no_line_is_drawn() -> None:
    lost = np.zeros(60, bool)
    lost[:5], lost[55:] = True, True
    rows = told(lost.tolist())
    np.testing.assert_array_equal(bridged(rows, []).signal, rows.signal)


def test_one_missing_reading_is_the_models() -> None:
    rows = told([False, True, False])
    for one, other in zip(bridged(rows, []), rows, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("length", LENGTHS)
def test_blocks_are_apart_and_inside(length: int) -> None:
    hidden = choose_hidden_rows(5000, length)
    starts = np.flatnonzero(np.diff(hidden.astype(int)) == 1) + 1
    assert (np.diff(starts) >= 2 * length).all()
    assert hidden.sum() == length * len(starts)
    assert not hidden[:length].any()
    assert not hidden[-length:].any()


def band_noise(highest_hz: float, rows: int = 8000) -> Floats:
    rng = np.random.default_rng(int(10 * highest_hz))
    spectrum = np.fft.rfft(rng.normal(size=rows))
    spectrum[np.fft.rfftfreq(rows, 1 / RATE_HZ) > highest_hz] = 0
    x = np.fft.irfft(spectrum, rows)
    return np.asarray(5.0 + x / x.std() + 0.05 * rng.normal(size=rows))


def test_of_a_sharp_spectrum_the_model_is_worth_less_than_it_says() -> None:
    z = band_noise(30.0)
    recipe = becalm.tune(becalm.Recording(z, rate_hz=RATE_HZ))
    shown = {one.readings: one for one in recipe.channel[0].hole}
    assert shown[8].sigma_growth > 0.05
    assert Recipe.from_toml(recipe.to_toml()) == recipe
    hidden = np.zeros(len(z), bool)
    for start in range(100, len(z) - 100, 97):
        hidden[start : start + 8] = True
    seen = becalm.Recording(np.where(hidden, np.nan, z), rate_hz=RATE_HZ)
    coverage = {}
    for name, hole in (("measured", recipe.channel[0].hole), ("the model's", ())):
        channel = recipe.channel[0].model_copy(update={"fill": True, "hole": hole})
        out = becalm.clean(seen, recipe.model_copy(update={"channel": (channel,)}))
        error, sigma = out.signal.samples[hidden, 0] - z[hidden], out.sigma.samples[hidden, 0]
        coverage[name] = float(np.mean(np.abs(error) <= sigma))
    assert 0.6 < coverage["measured"] < 0.8
    assert coverage["the model's"] < 0.6


def test_of_a_walk_the_model_is_worth_what_it_says() -> None:
    rng = np.random.default_rng(5)
    z = np.cumsum(rng.normal(size=8000)) + rng.normal(size=8000)
    holes = becalm.tune(becalm.Recording(z, rate_hz=RATE_HZ)).channel[0].hole
    assert max((one.sigma_growth for one in holes), default=0.0) < 0.3


@pytest.mark.parametrize("how", [{"causal": True}, {"wishes": becalm.Wishes(lag_s=0.2)}])
def test_a_filter_that_does_not_know_what_comes_needs_none(how: dict[str, object]) -> None:
    assert becalm.tune(becalm.Recording(band_noise(2.0), rate_hz=RATE_HZ), **how).channel[0].hole == ()  # type: ignore[arg-type]


def test_few_readings_show_nothing() -> None:
    assert becalm.tune(becalm.Recording(band_noise(20.0, 60), rate_hz=RATE_HZ)).channel[0].hole == ()
