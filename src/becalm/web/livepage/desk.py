"""The live dial: a channel's tuning changed amid a stream, taken back again, and what the filters then are."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from becalm.cleaning.recipe import ChannelRecipe, Recipe
from becalm.cleaning.steps import lag_in_rows
from becalm.errors import BecalmError, UsageError
from becalm.live.retuning import Heard, Retune
from becalm.web.tuner.dial import dial, told_of

_DIAL_S = 600.0  # the calmest position is that of a record so long
_FEWER = 4  # positions are told where each takes some hundredths of a second


class Desk:
    """What all who look on have asked of the filters.

    Parameters
    ----------
    now : callable
        Returns the recipe (TOML) that rows go through.
    retune : callable
        Asks for another one.
    """

    def __init__(self, now: Callable[[], str], retune: Retune) -> None:
        self._now, self._retune = now, retune
        self._lock = threading.Lock()
        self._asked: Recipe | None = None  # and not taken yet
        self._before: list[str] = []  # each turn

    @property
    def can_undo(self) -> bool:
        """Whether a turn can be taken back."""
        return bool(self._before)

    def turn(self, channel: int, density: float | None, noise_std: float | None, heard: Heard) -> None:
        """Take another process noise density (unit^2/s^(2 order - 1)), or noise (unit), for a channel.

        Raises
        ------
        UsageError
            If the channel has no dial.
        """
        with self._lock:
            base = self._asked or Recipe.from_toml(self._now())
            channels = list(base.channel)
            if channel >= len(channels) or not has_dial(channels[channel]):
                raise UsageError(f"Channel {channel} has no dial: it passes unchanged, or switches between modes.")
            told = {"process_noise_density": density, "noise_std": noise_std}
            update = {name: value for name, value in told.items() if value is not None}
            channels[channel] = channels[channel].model_copy(update={**update, "tuning_spread": 0.0})
            before = self._now()
            self._ask(base.model_copy(update={"channel": tuple(channels)}), lambda: self._before.append(before), heard)

    def undo(self, heard: Heard) -> None:
        """Take the last turn back.

        Raises
        ------
        UsageError
            If there is none.
        """
        with self._lock:
            if self._asked is not None:  # a turn that no row has gone through yet
                self._ask(Recipe.from_toml(self._now()), lambda: None, heard)
            elif self._before:
                self._ask(Recipe.from_toml(self._before[-1]), lambda: self._before.pop(), heard)
            else:
                raise UsageError("Nothing was turned since becalm began; there is nothing to undo.")

    def _ask(self, recipe: Recipe, then: Callable[[], object], heard: Heard) -> None:
        self._asked = recipe

        def told(why: str) -> None:
            with self._lock:
                if self._asked is recipe:
                    self._asked = None
                if not why:
                    then()
            heard(why)

        self._retune(lambda: recipe, told)


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
    read = Recipe.from_toml(recipe)
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
