"""Recipes that are asked for amid a stream: made beside it, taken without a jump, the newest one counts."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.arrays import Floats
from becalm.live.block import Block
from becalm.live.running.retuning import Retuning
from becalm.live.stream import Stream
from becalm.live.watching.meter import Meter
from becalm.live.watching.watch import Watch
from stream_recipes import KINDS, LAGGED, RATE_HZ, recipe_of, wander

PATIENCE_S = 30.0


def tuned(density: float, **how: object) -> Recipe:
    recipe = recipe_of(KINDS["order 2"], **how)
    return recipe.model_copy(
        update={"channel": (recipe.channel[0].model_copy(update={"process_noise_density": density}),)}
    )


FIRST, SECOND, THIRD = (tuned(density) for density in (100.0, 10.0, 1000.0))


class Fed:
    """A stream with rows without end."""

    def __init__(self) -> None:
        self.stream, self.retuning, self.meter = Stream(FIRST, 1 / RATE_HZ), Retuning(), Meter()
        self.watch = Watch(self.meter)
        self._values, self._row = wander(200_000)[:, np.newaxis], 0

    def told(self, rows: int) -> Floats:
        some = slice(self._row, self._row + rows)
        self._row = some.stop
        stamps = np.arange(some.start, some.stop) / RATE_HZ
        block = Block(("c0",), ("",), stamps, self._values[some], elapsed=np.ones(rows))
        return self.stream.take(block).signal[:, 0]

    def until(self, happened: Callable[[], bool]) -> None:
        """Go on taking what is asked for, without rows."""
        end = time.monotonic() + PATIENCE_S
        while not happened():
            assert time.monotonic() < end
            self.retuning.apply(self.stream, self.watch)
            time.sleep(0.001)


def test_a_recipe_is_taken_and_told() -> None:
    fed, heard = Fed(), list[str | None]()
    fed.told(500)
    fed.retuning.ask(lambda: SECOND, heard.append)
    fed.until(lambda: heard == [""])
    assert fed.stream.recipe == SECOND
    assert Recipe.from_toml(fed.meter.recipe) == SECOND


def test_no_turn_makes_the_signal_jump_however_soon_the_next_comes() -> None:
    fed, plain, heard = Fed(), Fed(), list[str | None]()
    parts, expected = [fed.told(1000)], [plain.told(1000)]
    for turn, recipe in enumerate([SECOND, THIRD, SECOND, FIRST, THIRD]):
        fed.retuning.ask(lambda recipe=recipe: recipe, heard.append)  # type: ignore[misc]
        while len(heard) == turn:
            fed.retuning.apply(fed.stream, fed.watch)
            parts.append(fed.told(7))
            expected.append(plain.told(7))
        for _ in range(turn * 5):
            parts.append(fed.told(7))
            expected.append(plain.told(7))
    signal, calm = np.concatenate(parts), np.concatenate(expected)
    assert heard == [""] * 5
    assert np.abs(np.diff(signal)).max() < 2 * np.abs(np.diff(calm)).max()
    assert not np.array_equal(signal, calm)


def test_a_filter_that_was_never_told_gives_way_without_a_trace() -> None:
    """The second turn comes before the first has a share: what is told is what the first filter tells, to the bit."""
    fed, plain = Fed(), Fed()
    for each in (fed, plain):
        each.told(500)
    for recipe in (SECOND, THIRD):
        fed.stream.retune(recipe)
        assert not fed.stream.is_handing_over
        np.testing.assert_array_equal(fed.told(5), plain.told(5))
    fed.told(20_000)
    assert not fed.stream.is_handing_over
    assert fed.stream.recipe == THIRD


def test_what_is_asked_while_one_filter_gives_way_waits() -> None:
    fed, heard = Fed(), list[str | None]()
    fed.told(500)
    fed.stream.retune(SECOND)
    while not fed.stream.is_handing_over:
        fed.told(1)
    fed.retuning.ask(lambda: THIRD, heard.append)
    for _ in range(200):
        fed.retuning.apply(fed.stream, fed.watch)
        time.sleep(0.001)
    assert (heard, fed.stream.recipe) == ([], SECOND)
    fed.told(20_000)
    fed.until(lambda: heard == [""])
    assert fed.stream.recipe == THIRD


@pytest.mark.parametrize(
    ("recipe", "says"),
    [(recipe_of(KINDS["order 2"], KINDS["order 2"]), "channels"), (tuned(1.0, **LAGGED), "lag")],
    ids=["channels", "lag"],
)
def test_what_cannot_be_is_refused_in_words(recipe: Recipe, says: str) -> None:
    fed, heard = Fed(), list[str | None]()
    fed.retuning.ask(lambda: recipe, heard.append)
    fed.until(lambda: bool(heard))
    assert says in str(heard[0])
    assert fed.stream.recipe == FIRST


def test_of_several_the_newest_is_taken_and_the_older_are_told() -> None:
    fed, heard = Fed(), list[tuple[str, str | None]]()
    fed.told(500)
    for name, recipe in (("one", SECOND), ("two", FIRST), ("three", THIRD)):
        fed.retuning.ask(lambda recipe=recipe: recipe, lambda says, name=name: heard.append((name, says)))  # type: ignore[misc]
    assert heard == [], "a signal's handler may ask, and tells nobody anything"
    fed.until(lambda: len(heard) == 3)
    assert heard == [("one", None), ("two", None), ("three", "")]
    assert fed.stream.recipe == THIRD


def test_what_nobody_foresaw_is_refused_in_words_and_the_stream_goes_on() -> None:
    def broken() -> Recipe:
        raise ZeroDivisionError("by nothing")

    fed, heard = Fed(), list[str | None]()
    fed.told(500)
    fed.retuning.ask(broken, heard.append)
    fed.until(lambda: bool(heard))
    assert heard == ["The recipe could not be taken (ZeroDivisionError: by nothing)."]
    fed.told(500)
    assert fed.stream.recipe == FIRST
    fed.retuning.ask(lambda: SECOND, heard.append)
    fed.until(lambda: heard[1:] == [""])
