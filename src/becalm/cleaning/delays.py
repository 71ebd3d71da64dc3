"""What a delay buys: for each channel of a recipe, how much noise is left if the output waits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial

from becalm.cleaning.limits_entry import delay_to_smooth
from becalm.cleaning.modes import modes_in_steps
from becalm.cleaning.recipe import ChannelRecipe, Recipe
from becalm.cleaning.steps import in_steps
from becalm.errors import ModelError
from becalm.identification.wishes.waiting import Delay, delay_curve, delays_of


def delays(recipe: Recipe) -> dict[str, tuple[Delay, ...]]:
    """Return the curve of each channel by its name, at the rate that it was tuned at.

    Parameters
    ----------
    recipe : Recipe
        Its noise and motions; of its mode nothing is used.

    Returns
    -------
    dict of str to tuple of Delay
        The soonest first, the limit last; nothing of a channel that passes unchanged, or never settles. Of one
        that switches a curve for each mode, "channel, mode", once that is in force for long.
    """
    step_s, found = 1 / recipe.tuned_on.rate_hz, dict[str, tuple[Delay, ...]]()
    for channel in recipe.channel:
        for name, curve in _curves(channel, step_s):
            with suppress(ModelError):  # without process noise, say
                found[name] = tuple(_judged(one, channel, step_s) for one in curve())
    return found


def _judged(delay: Delay, channel: ChannelRecipe, step_s: float) -> Delay:
    """Return a delay with the rows for which a reading waits until it is judged."""
    return replace(delay, wait_s=delay_to_smooth(channel.limits, delay.wait_s, step_s))


def _curves(channel: ChannelRecipe, step_s: float) -> Iterator[tuple[str, Callable[[], tuple[Delay, ...]]]]:
    if channel.motion is None:
        return
    tuning = in_steps(channel.motion, step_s)
    if channel.switching is None:
        yield channel.name, partial(delay_curve, tuning, step_s)
        return
    for mode in modes_in_steps(channel.switching, tuning, step_s).modes:
        if mode.lasts > 1:  # otherwise it never settles
            r = mode.noise_variance
            yield f"{channel.name}, {mode.name}", partial(delays_of, mode.component, r, r, step_s)
