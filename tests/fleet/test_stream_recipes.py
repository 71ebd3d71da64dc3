"""Recipes of a sensor that change while its stream runs, that are refused, or not there."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.streaming.handover import rows_to_forget
from becalm.errors import RecordingError
from becalm.fleet.stream.blocks import SensorRows
from becalm.fleet.stream.plan import SensorPlan
from becalm.live.stream import Stream
from made import RATE_HZ, recipe_of
from streaming import (
    CHANNELS,
    OTHER,
    RECIPE,
    ROWS,
    Shelf,
    Walker,
    assert_same_bits,
    by_stream,
    cut,
    lagged,
    rows_of,
    walker,
)


def test_another_recipe_takes_over_without_a_jump() -> None:
    rows, shelf = rows_of(ROWS), Shelf()
    one = Walker(SensorPlan(shelf))
    *before, after, last = cut(rows, [200, 400, 800])
    for batch in before:
        one.hear(batch)
    taken = one.steps[-1].recipe
    shelf.recipe = OTHER
    one.hear(after)
    one.hear(last)
    assert one.kinds().count("recipe") == 1
    assert one.steps[-1].recipe != taken
    np.testing.assert_array_equal(one.said.signal[:433], by_stream(rows).signal[:433])  # while the other one begins
    np.testing.assert_allclose(one.said.signal[-200:], by_stream(rows, OTHER).signal[-200:], rtol=1e-6)
    steps = np.abs(np.diff(one.said.signal[390:470], axis=0))
    assert steps.max() < 3.0


def test_a_handover_is_cut_as_a_stream_is() -> None:
    rows, outs = rows_of(ROWS), []
    for cuts in ([400], [400, 410, 437, 450, 466, 700]):
        shelf = Shelf()
        one = Walker(SensorPlan(shelf))
        first, *rest = cut(rows, cuts)
        one.hear(first)
        shelf.recipe = OTHER
        for batch in rest:
            one.hear(batch)
        outs.append(one.said)
    assert_same_bits(*outs)


def test_a_recipe_that_comes_with_refused_rows_takes_over_later(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, shelf = rows_of(ROWS), Shelf()
    one = Walker(SensorPlan(shelf))
    first, second, third = cut(rows, [400, 500])
    one.hear(first)
    shelf.recipe = OTHER
    with monkeypatch.context() as patched:
        patched.setattr(Stream, "take", refuse)
        assert one.hear(second).recipe == one.steps[0].recipe
    one.hear(third)
    assert one.kinds().count("recipe") == 1
    assert one.steps[-1].recipe != one.steps[0].recipe


def refuse(*_: object) -> None:
    raise RecordingError("These rows cannot be filtered.")


def test_a_third_recipe_waits_until_the_second_has_taken_over() -> None:
    rows, shelf = rows_of(ROWS), Shelf()
    one = Walker(SensorPlan(shelf))
    begun = 400 + rows_to_forget(OTHER, 1 / RATE_HZ)
    first, second, third, fourth = cut(rows, [400, begun + 1, begun + 2])
    one.hear(first)
    shelf.recipe = OTHER
    one.hear(second)
    shelf.recipe = recipe_of(*CHANNELS, density=1.0)
    assert one.hear(third).events == ()
    one.hear(fourth)
    one.hear(SensorRows(fourth.time_s + 60.0, fourth.values))
    assert one.kinds().count("recipe") == 2


@pytest.mark.parametrize("bad", [None, lagged(0.2), recipe_of("a")], ids=["gone", "lag", "channels"])
def test_a_recipe_that_cannot_take_over_is_refused_once_and_the_other_stays(bad: Recipe | None) -> None:
    rows, shelf = rows_of(ROWS), Shelf()
    one = Walker(SensorPlan(shelf))
    first, *rest = cut(rows, [300, 600, 900])
    one.hear(first)
    shelf.recipe = bad
    for batch in rest:
        one.hear(batch)
    refused = [event for event in one.events if event.kind == "refused"]
    assert len(refused) == 1
    assert refused[0].rows is None
    assert refused[0].says.endswith("The earlier recipe stays in use.")
    assert_same_bits(one.said, by_stream(rows))


@pytest.mark.parametrize("bad", [None, recipe_of("a", "c")], ids=["none", "channels"])
def test_rows_without_a_recipe_are_left_out_and_counted_until_there_is_one(bad: Recipe | None) -> None:
    rows, shelf = rows_of(300), Shelf(bad)
    one = Walker(SensorPlan(shelf))
    first, second = cut(rows, [100])
    step = one.hear(first)
    assert step.estimates is None
    assert [(event.kind, event.rows) for event in step.events] == [("refused", 100)]
    assert "100 rows were left out" in step.events[0].says
    shelf.recipe = RECIPE
    one.hear(second)
    assert_same_bits(one.said, by_stream(second))


def test_a_recipe_may_have_some_of_the_channels() -> None:
    one = walker(recipe_of("b"))
    step = one.hear(rows_of(100))
    assert step.estimates is not None
    assert step.estimates.places.tolist() == [1]
    np.testing.assert_array_equal(step.estimates.signal[:, 0], by_stream(rows_of(100)).signal[:, 1])
