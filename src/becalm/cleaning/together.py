"""The causal channels of a stream, sorted by size, so that one call of a kernel takes all of one size."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from becalm.cleaning.limits_entry import alarms_of, limits_of
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.steps import gate_of, in_steps
from becalm.cleaning.uncertainty import lasting_std
from becalm.core.streams import StreamChannel, Streams, Widening


def runs_together(recipe: ChannelRecipe, lag: int) -> bool:
    """Whether a channel is one causal filter, as most are in a stream."""
    return recipe.motion is not None and recipe.switching is None and not lag


def open_together(recipes: Sequence[ChannelRecipe], columns: Sequence[int], step_s: float) -> list[Streams]:
    """Start the causal channels of a stream.

    Parameters
    ----------
    recipes : sequence of ChannelRecipe
        Those that run together.
    columns : sequence of int
        Which column of the stream each of them is.
    step_s : float
        Step in seconds.

    Raises
    ------
    RecipeError
        If the numbers of one make no filter at this step.
    """
    sized = defaultdict[int, list[tuple[StreamChannel, int]]](list)
    for recipe, column in zip(recipes, columns, strict=True):
        channel = _stream_channel(recipe, step_s)
        sized[len(channel.component.drift)].append((channel, column))
    return [Streams([one for one, _ in group], [column for _, column in group]) for group in sized.values()]


def _stream_channel(recipe: ChannelRecipe, step_s: float) -> StreamChannel:
    assert recipe.motion is not None, "what has no motion passes unchanged"
    tuning, timing = in_steps(recipe.motion, step_s), recipe.timing
    return StreamChannel(
        tuning.component,
        tuning.noise_variance,
        limits_of(recipe.limits),
        alarms_of(recipe.limits),
        None if recipe.gate is None else gate_of(recipe.gate, step_s),
        Widening(
            1.0 + recipe.tuning_spread,
            None if timing is None else timing.std_s,
            0.0 if timing is None else timing.included_std,
            lasting_std(recipe.calibration, recipe.limits),
        ),
        recipe.unknown_from,
    )
