"""From one recipe to another amid a stream: no jump, an honest sigma, and the same bits through any cut or pause."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.streaming.handover import Handover, rows_to_forget
from becalm.cleaning.streaming.stream import StreamCleaner, Streamed
from becalm.core.arrays import Floats
from becalm.errors import ModelError, RecipeError

STEP_S = 0.01


def recipe_of(density: float, **more: object) -> Recipe:
    channel = ChannelRecipe(name="a", model="motion", order=2, process_noise_density=density, noise_std=0.2)
    made = Recipe(mode="causal", tuned_on=Origin(rate_hz=100), channel=(channel,))
    return made.model_copy(update=more)


QUICK, QUIET = recipe_of(50.0), recipe_of(0.05)


def readings(rows: int) -> Floats:
    rng = np.random.default_rng(5)
    return (np.sin(np.arange(rows) / 80) + rng.normal(0, 0.2, rows))[:, None]


def pushed(filters: StreamCleaner | Handover, values: Floats, sizes: list[int] | None = None) -> Streamed:
    parts, at, number = [], 0, 0
    while at < len(values):
        size = len(values) if sizes is None else sizes[number % len(sizes)]
        part = values[at : at + size]
        parts.append(filters.push(part, np.ones(len(part))))
        at, number = at + size, number + 1
    return Streamed(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def begun(values: Floats, rows: int = 300) -> Handover:
    former = StreamCleaner(QUICK, STEP_S)
    former.push(values, np.ones(len(values)))
    return Handover(former, StreamCleaner(QUIET, STEP_S), rows)


def test_the_signal_goes_from_one_filter_to_the_other_and_does_not_jump() -> None:
    values = readings(4000)
    told = pushed(begun(values[:1000]), values[1000:])
    quick = pushed(StreamCleaner(QUICK, STEP_S), values)
    np.testing.assert_array_equal(told.signal[:299], quick.signal[1000:1299])
    quiet = StreamCleaner(QUIET, STEP_S)
    np.testing.assert_array_equal(told.signal[600:], pushed(quiet, values[1000:]).signal[600:])
    largest = np.abs(np.diff(quick.signal[1000:], axis=0)).max()
    assert np.abs(np.diff(told.signal, axis=0)).max() <= largest
    assert (told.sigma > 0).all()


@settings(max_examples=20)
@given(st.lists(st.integers(1, 90), min_size=1, max_size=5), st.integers(0, 800))
def test_no_cut_and_no_pause_changes_a_bit(sizes: list[int], pause: int) -> None:
    values = readings(1800)
    whole = pushed(begun(values[:1000]), values[1000:])
    first = begun(values[:1000])
    one = pushed(first, values[1000 : 1000 + pause], sizes) if pause else None
    again, former = Handover.resume(first.snapshot(QUICK), QUIET)
    assert former == QUICK
    two = pushed(again, values[1000 + pause :], sizes) if pause < 800 else None
    parts = [part for part in (one, two) if part is not None]
    for found, wanted in zip((np.concatenate(a) for a in zip(*parts, strict=True)), whole, strict=True):
        np.testing.assert_array_equal(found, wanted)


def test_with_a_lag_rows_wait_and_none_is_lost() -> None:
    quick, quiet = (recipe.model_copy(update={"mode": "lagged", "lag_s": 0.05}) for recipe in (QUICK, QUIET))
    values = readings(1500)
    former = StreamCleaner(quick, STEP_S)
    early = former.push(values[:500], np.ones(500))
    handover = Handover(former, StreamCleaner(quiet, STEP_S), 100)
    told = pushed(handover, values[500:], [7, 30])
    rest = handover.finish()
    assert len(early.signal) + len(told.signal) + len(rest.signal) == 1500
    assert handover.is_over
    assert np.isfinite(told.signal).all()


def test_another_lag_is_refused() -> None:
    lagged = QUIET.model_copy(update={"mode": "lagged", "lag_s": 0.05})
    with pytest.raises(RecipeError, match="keeps its lag"):
        Handover(StreamCleaner(QUICK, STEP_S), StreamCleaner(lagged, STEP_S), 100)


@pytest.mark.parametrize("blob", [b"", b"nothing", bytes(200)])
def test_damaged_bytes_are_refused(blob: bytes) -> None:
    with pytest.raises(ModelError):
        Handover.resume(blob, QUIET)


def test_a_slow_filter_takes_long_to_forget() -> None:
    assert 32 <= rows_to_forget(QUICK, STEP_S) < rows_to_forget(QUIET, STEP_S) <= 1 << 16
    assert rows_to_forget(recipe_of(0.0), STEP_S) == 1 << 16
