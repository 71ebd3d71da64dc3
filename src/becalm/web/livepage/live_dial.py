"""The live dial: change the tuning of a channel while a stream runs, undo it, and report the filters in force."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from becalm.cleaning.dial_positions import dial, told_of
from becalm.cleaning.recipe import ChannelRecipe, Recipe
from becalm.cleaning.steps import lag_in_rows
from becalm.errors import BecalmError, UsageError
from becalm.live.retuning import Heard, Retune

_DIAL_S = 600.0  # the calmest position is that of a record so long
_REMEMBERED = 1000  # turns
NOT_BEGUN = "The stream has not begun yet."
_NOTHING = "Nothing was turned since becalm began; there is nothing to undo."
_NO_TURN = "A page turned a dial and did not say to what; reload it."
_FEWER = 4  # positions are told where each takes some hundredths of a second


Trail = list[Recipe]
"""What rows went through before each turn that can be taken back, and last what they go through now."""


class _Step:
    """What somebody asked, until it is taken or refused."""

    def __init__(self, take: Callable[[Trail], object], turns: int) -> None:
        self.take, self.turns, self.settled = take, turns, False


class LiveDial:
    """What all who look on have asked of the filters.

    Parameters
    ----------
    now : callable
        Returns the recipe (TOML) that rows go through; "" before the first.
    retune : callable
        Asks for another one.
    """

    def __init__(self, now: Callable[[], str], retune: Retune) -> None:
        self._now, self._retune = now, retune
        self._lock = threading.Lock()  # the thread that filters takes it too: nothing is read or made under it
        self._asked: tuple[_Step, ...] = ()  # and not settled yet
        self._before: Trail = []

    @property
    def can_undo(self) -> bool:
        """Whether a turn can be taken back."""
        return bool(self._before)

    def turn(self, channel: int, density: float | None, noise_std: float | None, heard: Heard) -> None:
        """Take another process noise density (unit^2/s^(2 order - 1)), or noise (unit), for a channel.

        Raises
        ------
        UsageError
            If the channel has no dial, or the stream has not begun.
        """
        told = {"process_noise_density": density, "noise_std": noise_std}
        update = {name: value for name, value in told.items() if value is not None}
        if not update:
            raise UsageError(_NO_TURN)
        _turned(self._running(), channel, update)  # whoever asks what cannot be hears of it at once
        self._ask(_Step(lambda trail: trail.append(_turned(trail[-1], channel, update)), +1), heard)

    def undo(self, heard: Heard) -> None:
        """Take the last turn back, also one that is asked for and not taken yet.

        Raises
        ------
        UsageError
            If there is none.
        """
        with self._lock:
            turns = len(self._before) + sum(step.turns for step in self._asked)
        if turns < 1:
            raise UsageError(_NOTHING)
        self._ask(_Step(_undone, -1), heard)

    def _running(self) -> Recipe:
        toml = self._now()
        if not toml:
            raise UsageError(NOT_BEGUN)
        return _read(toml)

    def _ask(self, step: _Step, heard: Heard) -> None:
        """Ask for what a step makes of the recipe that rows go through when it is made.

        With it comes what was asked before it and is not settled then: whatever is passed over for it is not lost.
        """
        with self._lock:
            asked = self._asked = (*self._asked, step)
        trail: Trail = []

        def recipe() -> Recipe:  # one at a time: what rows go through stays until this is taken, or refused
            trail[:] = [*self._before, self._running()]
            for each in asked:
                if not each.settled:
                    each.take(trail)
            return trail[-1]

        def told(why: str | None) -> None:
            with self._lock:
                if why == "":
                    self._before = trail[:-1][-_REMEMBERED:]
                if why is not None:
                    for each in asked:
                        each.settled = True
                self._asked = tuple(each for each in self._asked if each is not step and not each.settled)
            heard(why)

        self._retune(recipe, told)


@lru_cache(maxsize=4)
def _read(toml: str) -> Recipe:
    """Read a recipe, which takes up to tens of milliseconds, once for many questions."""
    return Recipe.from_toml(toml)


def _turned(recipe: Recipe, channel: int, update: dict[str, float]) -> Recipe:
    channels = list(recipe.channel)
    if channel >= len(channels):
        raise UsageError(f"There is no channel {channel + 1}; the stream has {len(channels)}. Reload the page.")
    if not has_dial(channels[channel]):
        why = "it passes unchanged" if channels[channel].switching is None else "it switches between modes"
        raise UsageError(f"Channel {channels[channel].name} has no dial: {why}.")
    channels[channel] = channels[channel].model_copy(update={**update, "tuning_spread": 0.0})
    return recipe.model_copy(update={"channel": tuple(channels)})


def _undone(trail: Trail) -> None:
    if len(trail) < 2:  # the turn that it was asked for has been refused
        raise UsageError(_NOTHING)
    del trail[-1]


def has_dial(channel: ChannelRecipe) -> bool:
    """Whether one number decides between noise and lag of a channel."""
    return channel.motion is not None and channel.switching is None


def facts(recipe: str, step_s: float) -> dict[str, Any]:
    """Say what the filters of a recipe (TOML) are, and what their dials would make of them.

    Returns
    -------
    dict
        "filters", one a channel, and "dials" by the channel's number.
    """
    read = _read(recipe)
    lag = 0 if read.lag_s is None else lag_in_rows(read.lag_s, step_s)
    dials, filters = {}, []
    for number, channel in enumerate(read.channel):
        filters.append(_filter(channel, step_s, lag))
        if has_dial(channel):
            any_density = channel.model_copy(update={"process_noise_density": 1.0, "tuning_spread": 0.0})
            dials[str(number)] = {**_positions(any_density, step_s, lag), "at": channel.process_noise_density}
    return {"filters": filters, "dials": dials}


@lru_cache(maxsize=64)
def _positions(channel: ChannelRecipe, step_s: float, lag: int) -> dict[str, list[float | None]]:
    """Return what a channel's filter is at each position of its dial, with what stands beside its motion."""
    alone = dial(channel, step_s, lag, round(_DIAL_S / step_s))
    if not channel.tone and channel.coloured_noise is None:
        return {name: values.tolist() for name, values in alone.items()}
    densities = alone["process_noise_density"][::_FEWER].tolist()
    told = [
        _filter(channel.model_copy(update={"process_noise_density": density}), step_s, lag) for density in densities
    ]
    figures = {name: [one.get(name) for one in told] for name in ("bandwidth_hz", "lag_s", "noise_left")}
    return {"process_noise_density": densities, **figures}


def _filter(channel: ChannelRecipe, step_s: float, lag: int) -> dict[str, Any]:
    try:
        return told_of(channel, step_s, lag)._asdict()
    except BecalmError as cause:
        return {"says": str(cause)}
