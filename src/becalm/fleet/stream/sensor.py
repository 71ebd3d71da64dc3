"""Process the stream of one sensor in micro-batches: from a state and new rows, return a new state and estimates.

Nothing is stored between calls, so a repeated micro-batch gives the same result on any worker.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.arrays import Floats
from becalm.errors import BecalmError, RecipeError
from becalm.files.units.unit_spelling import parse_header
from becalm.fleet.names import folder_name
from becalm.fleet.stream.blocks import EstimatedBlock, Event
from becalm.fleet.stream.plan import FIRST_ROWS, SensorPlan
from becalm.fleet.stream.reading import Entry, drop_late, drop_unstamped, read_messages, read_rows, split_by_lateness
from becalm.fleet.stream.state import SensorState
from becalm.live.block import Block, Loss, Output
from becalm.live.messages.stream import MessageStream
from becalm.live.running.learning_buffer import resolution_of
from becalm.live.stream import Stream

_LONGEST_NAME, _SHOWN = 255, 40  # largest length of a folder's name in bytes; letters of a longer name in messages
_ODD = 1.5  # smallest ratio of a stream's rate to its recipe's rate, or the inverse, that is reported


class SensorStep(NamedTuple):
    """The result of a micro-batch for a sensor."""

    state: SensorState | None  # None if nothing needs to be stored
    estimates: EstimatedBlock | None = None
    events: tuple[Event, ...] = ()
    timer_ms: int | None = None  # time of the next check for silence, in ms since 1970; None: keep the timer
    recipe: str = ""  # the hash of the recipe that was used


class SensorStreamProcessor:
    """A processor of micro-batches of any sensor; it stores no state.

    Parameters
    ----------
    plan : SensorPlan
        The options of each sensor.
    channels : tuple of str
        The channels of all sensors; each sensor has some of these.
    """

    def __init__(self, plan: SensorPlan, channels: tuple[str, ...]) -> None:
        self._plan, self._channels = plan, channels
        self._rate_hz = None if plan.messages is None else MessageStream(plan.messages).rate_hz

    def output_name(self, sensor: str) -> str:
        """Return the name of a sensor in the output, or "" if it is too long for a folder's name."""
        return sensor if len(folder_name(self._plan.key, sensor).encode(errors="replace")) <= _LONGEST_NAME else ""

    def process_rows(
        self, sensor: str, before: SensorState | None, entries: Sequence[Entry], now_ms: int
    ) -> SensorStep:
        """Process the new entries of a sensor.

        Parameters
        ----------
        sensor : str
            Name of the sensor.
        before : SensorState or None
            State of the sensor before the micro-batch; None for a new sensor.
        entries : sequence of Entry
            The new rows or messages, in any order.
        now_ms : int
            The time of Spark's clock, in milliseconds since 1970.

        Raises
        ------
        ModelError
            If the stored state is damaged or of another version; no entry is processed then.
        """
        state, back, timer_ms = self._with_rows_received(before, now_ms)
        stream = None if state.stream is None else Stream.resumed(state.stream)
        recipe = _current_recipe(self._plan, sensor)[0] if stream is None else stream.recipe
        block, numbers = self._read(entries, state, -np.inf if stream is None else stream.last_stamp_s, recipe)
        unchanged = state = replace(state, messages=numbers, held=Block.of_losses())
        if not sensor and not len(block):  # there are only losses, of an unknown sensor
            return SensorStep(None, None, _events(block.losses))
        remarks: tuple[Event, ...] = ()
        try:
            if stream is None:
                stream, state = self._begin(sensor, state, block)
                remarks = () if stream is None else _odd_rate(stream.recipe, block.time_s)
            else:
                remarks, state = self._retune(sensor, stream, state)
            if stream is None:
                step = SensorStep(replace(state, held=replace(block, losses=())), None, _events(block.losses))
            else:
                if back:
                    stream.notify_source_opened()
                ready, held = self._split(block)
                step = self._step_of(stream, replace(state, held=held), stream.take(ready))
        except BecalmError as cause:
            state = unchanged  # a new recipe was not applied either
            kept = None if state.stream is None and not numbers else state  # a sensor without a recipe needs no state
            remarks, step = (), SensorStep(kept, None, (*_events(block.losses), _refusal(cause, len(block))))
        timer_ms = None if step.state is None else timer_ms
        return step._replace(events=(*back, *remarks, *step.events), timer_ms=timer_ms, recipe=state.taken)

    def check_silence(self, before: SensorState, now_ms: int) -> SensorStep:
        """Check whether a sensor is silent; if so, report this, and filter the rows that wait for earlier rows."""
        if self._plan.silent_s is None or before.is_silent:
            return SensorStep(replace(before, is_watched=False))
        until_ms = before.heard_ms + _milliseconds(self._plan.silent_s)
        if until_ms > now_ms:
            return SensorStep(before, timer_ms=until_ms)
        state = replace(before, is_silent=True, is_watched=False)
        silent = Event("silent", None, f"No row came for {(now_ms - before.heard_ms) / 1000:g} s.")
        if state.stream is None:
            return SensorStep(state, None, (silent,))
        stream, emptied = Stream.resumed(state.stream), replace(state, held=Block.of_losses())
        try:
            step = self._step_of(stream, emptied, stream.take(state.held))
        except BecalmError as cause:  # for example if a restart of the stream removed its channels
            step = SensorStep(emptied, None, (_refusal(cause, len(state.held)),) if len(state.held) else ())
        return step._replace(events=(silent, *step.events), recipe=state.taken)

    def _with_rows_received(
        self, before: SensorState | None, now_ms: int
    ) -> tuple[SensorState, tuple[Event, ...], int | None]:
        """Return the state of a sensor after rows arrived, an event if it was silent, and the time of a new timer."""
        before = before or SensorState(now_ms)
        timer_ms = None
        if self._plan.silent_s is not None and not before.is_watched:
            timer_ms = now_ms + _milliseconds(self._plan.silent_s)
        is_watched = before.is_watched or timer_ms is not None
        state = replace(before, heard_ms=now_ms, is_silent=False, is_watched=is_watched)
        says = f"Rows came again after {(now_ms - before.heard_ms) / 1000:g} s."
        return state, (Event("back", None, says),) if before.is_silent else (), timer_ms

    def _read(
        self, entries: Sequence[Entry], state: SensorState, last_stamp_s: float, recipe: Recipe | None
    ) -> tuple[Block, Mapping[str, Any]]:
        if self._plan.messages is None:
            rows = drop_unstamped(read_rows(entries, self._channels, state.held))
            return drop_late(rows, last_stamp_s, state.heard_ms / 1000), state.messages
        block, numbers = read_messages(entries, self._plan.messages, state.held, state.messages, recipe)
        return drop_unstamped(block) if block.elapsed is None else block, numbers

    def _split(self, block: Block) -> tuple[Block, Block]:
        """Split rows into rows to filter now, and rows that wait; rows of messages never wait."""
        return split_by_lateness(block, self._plan.lateness_s if self._plan.messages is None else 0.0)

    def _begin(self, sensor: str, state: SensorState, block: Block) -> tuple[Stream | None, SensorState]:
        """Return a new stream of filters for a sensor, or None while it has too few rows; and the sensor's state."""
        if not sensor:
            raise RecipeError(f"The rows have no sensor name in {self._plan.key!r}.")
        if not self.output_name(sensor):
            raise RecipeError(
                f"The sensor name that begins with {sensor[:_SHOWN]!r} is too long for the name of a folder."
            )
        recipe = self._plan.recipes.recipe_for(sensor)
        stamps = block.time_s[np.isfinite(block.time_s)][:FIRST_ROWS]
        if len(stamps) < FIRST_ROWS:
            return None, state
        stream = Stream(recipe, 1 / (self._rate_hz or recipe.nominal_rate_hz), resolution_of(stamps))
        taken = _hash_of(recipe)
        return stream, replace(state, asked=taken, taken=taken)

    def _retune(self, sensor: str, stream: Stream, state: SensorState) -> tuple[tuple[Event, ...], SensorState]:
        """Apply the book's recipe if it has changed, but not while an earlier change is in progress."""
        recipe, says, hashed = _current_recipe(self._plan, sensor)
        if hashed == state.asked or stream.is_handing_over:
            return (), state
        state = replace(state, asked=hashed)
        if hashed == state.taken:
            return (), state
        if recipe is not None:
            try:
                stream.retune(recipe)
            except BecalmError as cause:
                says = str(cause)
            else:
                return (Event("recipe", None, "Another recipe takes over."),), replace(state, taken=hashed)
        return (Event("refused", None, f"{says} The earlier recipe stays in use."),), state

    def _step_of(self, stream: Stream, state: SensorState, output: Output) -> SensorStep:
        estimates = None
        if len(output):
            places = np.array([self._place(channel.name) for channel in stream.recipe.channel], np.int64)
            estimates = EstimatedBlock(places, output.time_s, output.signal, output.sigma, output.verdicts)
        state = replace(state, stream=stream.checkpoint("", ""))
        return SensorStep(state, estimates, _events(output.losses))

    def _place(self, name: str) -> int:
        """Return the index of a recipe's channel among the fleet's channels; "load (N)" and "load" are the same."""
        alike = [k for k, own in enumerate(self._channels) if name in (own, parse_header(own)[0])]
        alike = alike or [k for k, own in enumerate(self._channels) if parse_header(name)[0] == own]
        if len(alike) != 1:
            raise RecipeError(
                f"The recipe cleans {name!r}, but the stream has {', '.join(map(repr, self._channels))}; "
                "restart the stream when all recipes are in place."
            )
        return alike[0]


def _current_recipe(plan: SensorPlan, sensor: str) -> tuple[Recipe | None, str, str]:
    """Return the current recipe of a sensor, or None and an error message; and the hash of the recipe or message."""
    try:
        recipe = plan.recipes.recipe_for(sensor)
    except BecalmError as cause:
        return None, str(cause), hashlib.sha256(str(cause).encode()).hexdigest()
    return recipe, "", _hash_of(recipe)


@lru_cache(maxsize=4096)
def _hash_of(recipe: Recipe) -> str:
    """Return the SHA-256 of a recipe's text."""
    return hashlib.sha256(recipe.to_toml().encode()).hexdigest()


def _odd_rate(recipe: Recipe, time_s: Floats) -> tuple[Event, ...]:
    """Return an event if the rate of the rows differs by a factor of `_ODD` or more from the recipe's rate."""
    steps_s = np.diff(time_s[np.isfinite(time_s)][:FIRST_ROWS])
    steps_s = steps_s[steps_s > 0]
    if not len(steps_s) or 1 / _ODD < np.median(steps_s) * recipe.nominal_rate_hz < _ODD:
        return ()
    says = (
        f"Rows come at about {1 / np.median(steps_s):.3g} Hz, but their recipe is for {recipe.nominal_rate_hz:.3g} Hz"
    )
    return (Event("rate", None, f"{says}; tune a recipe on rows at this rate."),)


def _refusal(cause: BecalmError, rows: int) -> Event:
    return Event("refused", rows, f"{cause} {rows} rows were left out." if rows else str(cause))


def _events(losses: Sequence[Loss]) -> tuple[Event, ...]:
    return tuple(Event(loss.kind.value, loss.rows, loss.says) for loss in losses)


def _milliseconds(time_s: float | None) -> int:
    return round(1000 * (time_s or 0.0))
