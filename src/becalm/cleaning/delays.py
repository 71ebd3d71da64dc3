"""Compute the trade-off of noise against lag for each channel of a recipe."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial

from becalm.cleaning.figures import modes_in_steps
from becalm.cleaning.limits_entry import delay_to_smooth
from becalm.cleaning.recipe import ChannelRecipe, Recipe
from becalm.cleaning.steps import in_steps
from becalm.errors import ModelError
from becalm.identification.wishes.gain_of_waiting import Delay, delay_curve, delays_of


def delays(recipe: Recipe) -> dict[str, tuple[Delay, ...]]:
    """Return the trade-off curve of each channel by its name, at the rate of the tuning recording.

    Parameters
    ----------
    recipe : Recipe
        Recipe whose noise and motions are used; its mode is ignored.

    Returns
    -------
    dict of str to tuple of Delay
        Shortest delay first; the last one is within 0.1 dB of the smoother. A channel that passes unchanged, or has no
        steady state, has no curve. A channel with several modes has a curve for each mode that has a steady state, by
        the name "channel, mode".

    Raises
    ------
    RecipeError
        If the parameters of a channel do not make a valid filter at this rate.
    """
    step_s, curves = 1 / recipe.tuned_on.rate_hz, dict[str, tuple[Delay, ...]]()
    for channel in recipe.channel:
        for name, curve in _curves(channel, step_s):
            with suppress(ModelError):  # for example without process noise
                curves[name] = tuple(_judged(one, channel, step_s) for one in curve())
    return curves


def _judged(delay: Delay, channel: ChannelRecipe, step_s: float) -> Delay:
    """Return the delay with the rows added for which the outlier test waits."""
    return replace(delay, wait_s=delay_to_smooth(channel.limits, delay.wait_s, step_s))


def _curves(channel: ChannelRecipe, step_s: float) -> Iterator[tuple[str, Callable[[], tuple[Delay, ...]]]]:
    if channel.motion is None:
        return
    tuning = in_steps(channel.motion, step_s)
    if channel.switching is None:
        yield channel.name, partial(delay_curve, tuning, step_s)
        return
    for mode in modes_in_steps(channel.switching, tuning, step_s).modes:
        if mode.lasts > 1:  # step; a shorter mode has no steady state
            r = mode.noise_variance
            yield f"{channel.name}, {mode.name}", partial(delays_of, mode.component, r, r, step_s)
