"""All that a recipe's stream runs, compiled or loaded before the first row comes."""

from __future__ import annotations

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe, Recipe
from becalm.cleaning.stream import StreamCleaner

_ROWS = 64  # as many tell any state


def warm_up(recipe: Recipe, step_s: float) -> None:
    """Load or compile the kernels that a stream needs, by a short stream of its own; it may run beside all else.

    Parameters
    ----------
    recipe : Recipe
        What the stream will do.
    step_s : float
        Its step, in seconds.

    Raises
    ------
    UsageError
        As `StreamCleaner`.
    """
    channels = tuple(channel.model_copy(update={"limits": None}) for channel in recipe.channel)
    lag_s = None if recipe.lag_s is None else step_s  # a kernel is the same for any lag
    stream = StreamCleaner(recipe.model_copy(update={"channel": channels, "lag_s": lag_s}), step_s)
    wave = np.sin(np.arange(_ROWS))[:, np.newaxis] * [_noise_std(channel) for channel in channels]
    stream.push(wave, np.ones(_ROWS))
    stream.finish()


def _noise_std(channel: ChannelRecipe) -> float:
    return channel.noise_std or 1.0
