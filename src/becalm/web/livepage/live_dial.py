"""The live dial: change the tuning of a channel while a stream runs, undo it, and report the filters in force."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from becalm.cleaning.dial_positions import dial, summary_of
from becalm.cleaning.recipes.recipe import ChannelRecipe, Recipe
from becalm.cleaning.recipes.steps import lag_in_rows
from becalm.errors import BecalmError, UsageError
from becalm.live.running.retuning import Retune, RetuneCallback

_DIAL_S = 600.0  # length of the record whose strongest smoothing is the last position of a dial
_REMEMBERED = 1000  # limit of the changes that can be undone
NOT_BEGUN = "The stream has not begun yet."
_NOTHING = "No filter was changed since becalm began; there is nothing to undo."
_NO_TURN = "A page turned a dial but did not send a value; reload it."
_FEWER = 4  # with tones or coloured noise only every fourth position is computed, because each takes some 0.01 s


Trail = list[Recipe]
"""The recipes before each change that can be undone, oldest first, and at the end the recipe in force."""


class _ChangeRequest:
    """A requested change: `apply` changes a trail, `turns` is the number of recipes that it adds there (undo: -1)."""

    def __init__(self, apply: Callable[[Trail], object], turns: int) -> None:
        self.apply, self.turns, self.settled = apply, turns, False


class LiveDial:
    """Requests changes of a stream's filters for all viewers, and undoes them.

    Parameters
    ----------
    now : callable
        Function that returns the recipe in force (TOML); "" before the first row.
    retune : callable
        Function that requests another recipe, as `Runner.retune` does.
    """

    def __init__(self, now: Callable[[], str], retune: Retune) -> None:
        self._now, self._retune = now, retune
        self._lock = threading.Lock()  # the filtering thread needs it too: hold it only briefly
        self._requests: tuple[_ChangeRequest, ...] = ()  # neither accepted nor refused yet
        self._history: Trail = []

    @property
    def can_undo(self) -> bool:
        """Return whether a change can be undone."""
        return bool(self._history)

    def turn(self, channel: int, density: float | None, noise_std: float | None, on_result: RetuneCallback) -> None:
        """Request another process noise density or noise standard deviation for a channel.

        Parameters
        ----------
        channel : int
            Number of the channel, from 0.
        density, noise_std : float or None
            New values, in unit^2/s^(2 order - 1) and in unit; None keeps the old one.
        on_result : callable
            Function that gets the outcome: "" if the stream accepts the change, the reason if it refuses, None if a
            newer request replaces this one.

        Raises
        ------
        UsageError
            If there is no value, the channel does not exist or has no dial, or the stream has not begun.
        """
        values = {"process_noise_density": density, "noise_std": noise_std}
        update = {name: value for name, value in values.items() if value is not None}
        if not update:
            raise UsageError(_NO_TURN)
        _changed_recipe(self._running(), channel, update)  # raises at once if the change is impossible
        self._ask(
            _ChangeRequest(lambda trail: trail.append(_changed_recipe(trail[-1], channel, update)), +1), on_result
        )

    def undo(self, on_result: RetuneCallback) -> None:
        """Request to undo the last change, even if the stream has not accepted that change yet.

        Raises
        ------
        UsageError
            If there is no change to undo.
        """
        with self._lock:
            turns = len(self._history) + sum(step.turns for step in self._requests)
        if turns < 1:
            raise UsageError(_NOTHING)
        self._ask(_ChangeRequest(_undone, -1), on_result)

    def _running(self) -> Recipe:
        toml = self._now()
        if not toml:
            raise UsageError(NOT_BEGUN)
        return _read(toml)

    def _ask(self, step: _ChangeRequest, on_result: RetuneCallback) -> None:
        """Request a change of the recipe that is in force when the stream processes the request.

        This request replaces earlier requests. It therefore also applies their changes, if they are not settled by
        then.
        """
        with self._lock:
            requests = self._requests = (*self._requests, step)
        trail: Trail = []

        def recipe() -> Recipe:  # the recipe in force cannot change before this one is accepted or refused
            trail[:] = [*self._history, self._running()]
            for each in requests:
                if not each.settled:
                    each.apply(trail)
            return trail[-1]

        def settle(why: str | None) -> None:
            with self._lock:
                if why == "":
                    self._history = trail[:-1][-_REMEMBERED:]
                if why is not None:
                    for each in requests:
                        each.settled = True
                self._requests = tuple(each for each in self._requests if each is not step and not each.settled)
            on_result(why)

        self._retune(recipe, settle)


@lru_cache(maxsize=4)
def _read(toml: str) -> Recipe:
    """Parse a recipe; the result is cached, because parsing takes up to tens of milliseconds."""
    return Recipe.from_toml(toml)


def _changed_recipe(recipe: Recipe, channel: int, update: dict[str, float]) -> Recipe:
    channels = list(recipe.channel)
    if channel >= len(channels):
        raise UsageError(f"There is no channel {channel + 1}; the stream has {len(channels)}. Reload the page.")
    if not has_dial(channels[channel]):
        why = "it passes unchanged" if channels[channel].switching is None else "its filter has several modes"
        raise UsageError(f"Channel {channels[channel].name} has no dial: {why}.")
    channels[channel] = channels[channel].model_copy(update={**update, "tuning_spread": 0.0})
    return recipe.model_copy(update={"channel": tuple(channels)})


def _undone(trail: Trail) -> None:
    if len(trail) < 2:  # the change to undo was refused
        raise UsageError(_NOTHING)
    del trail[-1]


def has_dial(channel: ChannelRecipe) -> bool:
    """Return whether one number sets the trade-off between noise and lag of a channel."""
    return channel.motion is not None and channel.switching is None


def describe_filters(recipe: str, step_s: float) -> dict[str, Any]:
    """Describe the filters of a recipe (TOML), and the filter at each position of their dials.

    Returns
    -------
    dict
        "filters": a summary for each channel; "dials": figures at each position, by the number of the channel.

    Raises
    ------
    BecalmError
        If the recipe is not valid at this sampling interval.
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
    """Describe a channel's filter at each position of its dial, with its tones and its coloured noise."""
    positions = dial(channel, step_s, lag, round(_DIAL_S / step_s))
    if not channel.tone and channel.coloured_noise is None:
        return {name: values.tolist() for name, values in positions.items()}
    densities = positions["process_noise_density"][::_FEWER].tolist()
    filters = [
        _filter(channel.model_copy(update={"process_noise_density": density}), step_s, lag) for density in densities
    ]
    figures = {name: [one.get(name) for one in filters] for name in ("bandwidth_hz", "lag_s", "noise_left")}
    return {"process_noise_density": densities, **figures}


def _filter(channel: ChannelRecipe, step_s: float, lag: int) -> dict[str, Any]:
    try:
        return summary_of(channel, step_s, lag)._asdict()
    except BecalmError as cause:
        return {"says": str(cause)}
