"""The stream of one sensor, a micro-batch at a time: a state and what came in, another state and what is told out.

Nothing is remembered between calls, so a micro-batch that is done again tells the same, wherever it is done.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.recipe import Recipe
from becalm.errors import BecalmError, RecipeError
from becalm.files.units import parse_header
from becalm.fleet.stream.blocks import Event, Told
from becalm.fleet.stream.plan import FIRST_ROWS, SensorPlan
from becalm.fleet.stream.reading import Entry, parted, read_messages, read_rows, timely
from becalm.fleet.stream.state import SensorState
from becalm.live.block import Block, Loss, Output
from becalm.live.learning import resolution_of
from becalm.live.messages.stream import MessageStream
from becalm.live.stream import Stream


class Step(NamedTuple):
    """What a micro-batch did to a sensor."""

    state: SensorState
    told: Told | None = None
    events: tuple[Event, ...] = ()
    wake_ms: int | None = None  # when to look whether it is silent; None leaves that as it is


class SensorWalk:
    """Takes a sensor's stream from micro-batch to micro-batch.

    Parameters
    ----------
    plan : SensorPlan
        What is done.
    channels : tuple of str
        The channels of all sensors; each has some of them.
    """

    def __init__(self, plan: SensorPlan, channels: tuple[str, ...]) -> None:
        self._plan, self._channels = plan, channels
        self._rate_hz = None if plan.messages is None else MessageStream(plan.messages).rate_hz

    def hear(self, sensor: str, before: SensorState | None, entries: Sequence[Entry], now_ms: int) -> Step:
        """Take what came of a sensor.

        Parameters
        ----------
        sensor : str
            Its name.
        before : SensorState or None
            Where it stood; None of one that was never heard of.
        entries : sequence of Entry
            What came, in any order.
        now_ms : int
            The clock of the engine, in milliseconds since 1970.
        """
        state, back, wake_ms = self._awake(before, now_ms)
        block, numbers = self._read(entries, state)
        state = replace(state, messages=numbers, held=Block.of_losses())
        try:
            stream, state, said = self._stream(sensor, state, block)
            if stream is None:
                step = Step(replace(state, held=replace(block, losses=())), None, _events(block.losses))
            else:
                if back:
                    stream.opened()
                ready, held = parted(block, self._plan.lateness_s)
                step = self._after(stream, replace(state, held=held), stream.take(ready))
        except BecalmError as cause:
            left_out = Event("refused", len(block), f"{cause} {len(block)} rows were left out.")
            said, step = (), Step(state, None, (*_events(block.losses), left_out))
        return step._replace(events=(*back, *said, *step.events), wake_ms=wake_ms)

    def wake(self, before: SensorState, now_ms: int) -> Step:
        """Look whether a sensor is silent; if so say it, and tell the rows that wait for earlier ones."""
        until_ms = before.heard_ms + _milliseconds(self._plan.silent_s)
        if before.is_silent or until_ms > now_ms:
            return Step(before, wake_ms=None if before.is_silent else until_ms)
        state = replace(before, is_silent=True)
        silent = Event("silent", None, f"No row came for {(now_ms - before.heard_ms) / 1000:g} s.")
        if state.stream is None:
            return Step(state, None, (silent,))
        stream = Stream.resumed(state.stream)
        step = self._after(stream, replace(state, held=Block.of_losses()), stream.take(state.held))
        return step._replace(events=(silent, *step.events))

    def _awake(self, before: SensorState | None, now_ms: int) -> tuple[SensorState, tuple[Event, ...], int | None]:
        """Return the state of a sensor that is heard now, whether it is back, and when to look for it again."""
        wake_ms = None if self._plan.silent_s is None else now_ms + _milliseconds(self._plan.silent_s)
        if before is None:
            return SensorState(now_ms), (), wake_ms
        state = replace(before, heard_ms=now_ms, is_silent=False)
        if not before.is_silent:
            return state, (), None
        says = f"Rows came again after {(now_ms - before.heard_ms) / 1000:g} s."
        return state, (Event("back", None, says),), wake_ms

    def _read(self, entries: Sequence[Entry], state: SensorState) -> tuple[Block, Mapping[str, Any]]:
        if self._plan.messages is None:
            rows = read_rows(entries, self._channels, state.held)
            return timely(rows, state.told_to_s), state.messages
        return read_messages(entries, self._plan.messages, state.held, state.messages)

    def _stream(
        self, sensor: str, state: SensorState, block: Block
    ) -> tuple[Stream | None, SensorState, tuple[Event, ...]]:
        """Return a sensor's filters, None while it has too few rows to begin."""
        if state.stream is not None:
            return self._retuned(sensor, Stream.resumed(state.stream), state)
        if not sensor:
            raise RecipeError(f"Nothing in {self._plan.key!r} tells whose they are.")
        recipe = self._plan.recipes.recipe_for(sensor)
        stamps = block.time_s[np.isfinite(block.time_s)][:FIRST_ROWS]
        if len(stamps) < FIRST_ROWS:
            return None, state, ()
        stream = Stream(recipe, 1 / (self._rate_hz or recipe.nominal_rate_hz), resolution_of(stamps))
        taken = hash_of(recipe)
        return stream, replace(state, asked=taken, taken=taken), ()

    def _retuned(
        self, sensor: str, stream: Stream, state: SensorState
    ) -> tuple[Stream, SensorState, tuple[Event, ...]]:
        """Let another recipe take over where the book has one, unless one just does: then later."""
        recipe, says, asked = _asked(self._plan, sensor)
        if asked == state.asked or stream.gives_way:
            return stream, state, ()
        state = replace(state, asked=asked)
        if asked == state.taken:
            return stream, state, ()
        if recipe is not None:
            try:
                stream.retuned(recipe)
            except BecalmError as cause:
                says = str(cause)
            else:
                return stream, replace(state, taken=asked), (Event("recipe", None, "Another recipe takes over."),)
        return stream, state, (Event("refused", None, f"{says} The recipe that was there stays."),)

    def _after(self, stream: Stream, state: SensorState, output: Output) -> Step:
        told, told_to_s = None, state.told_to_s
        if len(output):
            told_to_s = float(output.time_s[-1])
            places = np.array([self._place(channel.name) for channel in stream.recipe.channel], np.int64)
            told = Told(places, output.time_s, output.signal, output.sigma, output.verdicts)
        state = replace(state, stream=stream.checkpoint("", ""), told_to_s=told_to_s)
        return Step(state, told, _events(output.losses))

    def _place(self, name: str) -> int:
        """Return which of the fleet's channels a recipe's is; "load (N)" may be called "load" there."""
        alike = [k for k, own in enumerate(self._channels) if name in (own, parse_header(own)[0])]
        alike = alike or [k for k, own in enumerate(self._channels) if parse_header(name)[0] == own]
        if len(alike) != 1:
            raise RecipeError(
                f"The recipe cleans {name!r}, but the stream tells {', '.join(map(repr, self._channels))}; "
                "name all channels of the fleet's recipes."
            )
        return alike[0]


def _asked(plan: SensorPlan, sensor: str) -> tuple[Recipe | None, str, str]:
    """Return the recipe that a book has now, or why it has none; and the hash of either."""
    try:
        recipe = plan.recipes.recipe_for(sensor)
    except BecalmError as cause:
        return None, str(cause), hashlib.sha256(str(cause).encode()).hexdigest()
    return recipe, "", hash_of(recipe)


@lru_cache(maxsize=4096)
def hash_of(recipe: Recipe) -> str:
    """Return the SHA-256 of a recipe's text."""
    return hashlib.sha256(recipe.to_toml().encode()).hexdigest()


def _events(losses: Sequence[Loss]) -> tuple[Event, ...]:
    return tuple(Event(loss.kind.value, loss.rows, loss.says) for loss in losses)


def _milliseconds(time_s: float | None) -> int:
    return round(1000 * (time_s or 0.0))
