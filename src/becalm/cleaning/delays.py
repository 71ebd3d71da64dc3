"""Compute the trade-off of noise against lag for each channel of a recipe."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial

from becalm.cleaning.channels.figures import modes_in_steps
from becalm.cleaning.recipes.limits_entry import least_lag_s
from becalm.cleaning.recipes.recipe import ChannelRecipe, Recipe
from becalm.cleaning.recipes.steps import in_steps
from becalm.errors import ModelError
from becalm.identification.wishes.gain_of_waiting import Delay, delay_curve, delays_of


def delays(recipe: Recipe) -> dict[str, tuple[Delay, ...]]:
    """Return the trade-off curve of each channel, noise against lag, at the rate of the tuning recording.

    Parameters
    ----------
    recipe : Recipe
        The recipe; its mode (causal, lagged or smoothed) is ignored.

    Returns
    -------
    dict of str to tuple of Delay
        Curves by the name of the channel. A curve has the shortest delay first; its last one has at most 0.1 dB more
        noise than the smoother. A channel that passes unchanged, or whose filter has no steady state, has no curve. A
        channel with several modes has a curve for each mode with a steady state, under the name "channel, mode".

    Raises
    ------
    RecipeError
        If the parameters of a channel do not make a valid filter at this rate.
    """
    step_s, curves = 1 / recipe.tuned_on.rate_hz, dict[str, tuple[Delay, ...]]()
    for channel in recipe.channel:
        for name, curve in _curves(channel, step_s):
            with suppress(ModelError):  # no steady state, for example because there is no process noise
                curves[name] = tuple(_with_outlier_test(delay, channel, step_s) for delay in curve())
    return curves


def _with_outlier_test(delay: Delay, channel: ChannelRecipe, step_s: float) -> Delay:
    """Return the delay, longer by the rows that the outlier test waits for."""
    return replace(delay, wait_s=least_lag_s(channel.limits, delay.wait_s, step_s))


def _curves(channel: ChannelRecipe, step_s: float) -> Iterator[tuple[str, Callable[[], tuple[Delay, ...]]]]:
    """Yield the name of each curve of a channel, and a function that computes the curve."""
    if channel.motion is None:
        return
    tuning = in_steps(channel.motion, step_s)
    if channel.switching is None:
        yield channel.name, partial(delay_curve, tuning, step_s)
        return
    for mode in modes_in_steps(channel.switching, tuning, step_s).modes:
        if mode.lasts > 1:  # mean duration in steps; a mode of one step has no steady state
            r = mode.noise_variance
            yield f"{channel.name}, {mode.name}", partial(delays_of, mode.component, r, r, step_s)
