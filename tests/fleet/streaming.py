"""What tests of streams over a fleet share: books of recipes, rough rows, and a sensor walked by hand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count, pairwise
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.arrays import Codes, Floats
from becalm.errors import RecipeError
from becalm.fleet.stream.blocks import Event, SensorRows
from becalm.fleet.stream.plan import FIRST_ROWS, SensorPlan
from becalm.fleet.stream.reading import Entry
from becalm.fleet.stream.sensor import SensorStep, SensorStreamProcessor
from becalm.fleet.stream.state import SensorState
from becalm.live.block import Block
from becalm.live.running.learning_buffer import resolution_of
from becalm.live.stream import Stream
from made import RATE_HZ, recipe_of, walk

CHANNELS = ("a", "b")
BEGINS_S = 1.764e9
ROWS = 1200
NOW_MS = round(BEGINS_S * 1000) + 60_000
RECIPE = recipe_of(*CHANNELS)
OTHER = recipe_of(*CHANNELS, density=0.25)


@dataclass
class Shelf:
    """A book whose recipes a test changes."""

    recipe: Recipe | None = RECIPE

    def recipe_for(self, sensor: str) -> Recipe:
        """Return the one there is."""
        if self.recipe is None:
            raise RecipeError(f"There is no recipe for {sensor!r}.")
        return self.recipe

    def channels(self) -> tuple[str, ...]:
        """Return those of all recipes that tests put there."""
        return CHANNELS


class Said(NamedTuple):
    """All that was told of a sensor's rows."""

    time_s: Floats
    signal: Floats
    sigma: Floats
    verdicts: Codes


def rows_of(rows: int, seed: int = 1) -> SensorRows:
    """Return rows of two channels, stretches of which are missing, in microseconds since 1970, with gaps."""
    steps = np.arange(rows) + 30 * (np.arange(rows) > rows // 3) + 400 * (np.arange(rows) > rows // 2)
    values = np.column_stack([walk(seed, rows, holes=3), walk(seed + 1, rows)])
    values[rows // 4] += 300.0
    return SensorRows(np.round((BEGINS_S + steps / RATE_HZ) * 1e6) / 1e6, values)


def by_stream(rows: SensorRows, recipe: Recipe = RECIPE) -> Said:
    """Return what a live stream tells of rows."""
    stream = Stream(recipe, 1 / RATE_HZ, resolution_of(rows.time_s[:FIRST_ROWS]))
    told = stream.take(Block(CHANNELS, ("m", "m"), rows.time_s, rows.values))
    return Said(told.time_s, told.signal, told.sigma, told.verdicts)


@dataclass
class Walker:
    """One sensor, walked through micro-batches."""

    plan: SensorPlan
    state: bytes | None = None
    now_ms: int = 0
    sensor: str = "s"
    steps: list[SensorStep] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._walk = SensorStreamProcessor(self.plan, CHANNELS)
        self._places: Iterator[int] = count()

    def hear(self, *batches: SensorRows) -> SensorStep:
        """Take a micro-batch in which these entries come."""
        return self.take([Entry(next(self._places), rows.packed(), 0.0) for rows in batches])

    def take(self, entries: Sequence[Entry]) -> SensorStep:
        """Take a micro-batch of entries."""
        before = None if self.state is None else SensorState.unpacked(self.state)
        return self._kept(self._walk.process_rows(self.sensor, before, entries, self.now_ms))

    def wake(self) -> SensorStep:
        """Look whether it is silent."""
        assert self.state is not None
        return self._kept(self._walk.check_silence(SensorState.unpacked(self.state), self.now_ms))

    def _kept(self, step: SensorStep) -> SensorStep:
        self.state = None if step.state is None else step.state.packed()
        self.steps.append(step)
        return step

    @property
    def said(self) -> Said:
        """All that was told so far."""
        told = [step.estimates for step in self.steps if step.estimates is not None]
        return Said(*(np.concatenate([getattr(one, name) for one in told]) for name in Said._fields))

    @property
    def events(self) -> list[Event]:
        """All that befell it so far."""
        return [event for step in self.steps for event in step.events]

    def kinds(self) -> list[str]:
        """The kinds of what befell it."""
        return [event.kind for event in self.events]


def cut(rows: SensorRows, cuts: Sequence[int]) -> list[SensorRows]:
    """Cut rows into micro-batches."""
    return [part(rows, slice(a, b)) for a, b in pairwise([0, *sorted(cuts), len(rows.time_s)])]


def part(rows: SensorRows, which: slice | Sequence[int]) -> SensorRows:
    """Return some rows."""
    return rows._replace(time_s=rows.time_s[which], values=rows.values[which])


def assert_same_bits(got: Said, expected: Said) -> None:
    """Check that the same was told."""
    for name in Said._fields:
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name), err_msg=name)


def walker(recipe: Recipe | None = RECIPE, now_ms: int = 0, **plan: Any) -> Walker:
    """Return a sensor's way through micro-batches, by a recipe or none."""
    return Walker(SensorPlan(Shelf(recipe), **plan), now_ms=now_ms)


def lagged(lag_s: float) -> Recipe:
    """Return the recipe with a lag."""
    return RECIPE.model_copy(update={"mode": "lagged", "lag_s": lag_s})
