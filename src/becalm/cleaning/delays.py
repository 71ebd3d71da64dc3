"""What a delay buys: for each channel of a recipe, how much noise is left if the output waits."""

from __future__ import annotations

from becalm.cleaning.recipe import Recipe
from becalm.cleaning.steps import in_steps
from becalm.errors import ModelError
from becalm.noise.waiting import Delay, delay_curve


def delays(recipe: Recipe) -> dict[str, tuple[Delay, ...]]:
    """Return the curve of each channel by its name, at the rate that it was tuned at.

    Parameters
    ----------
    recipe : Recipe
        Its noise and motions; of its mode nothing is used.

    Returns
    -------
    dict of str to tuple of Delay
        The soonest first, the limit last; nothing of a channel that passes unchanged, or never settles.
    """
    step_s, found = 1 / recipe.tuned_on.rate_hz, {}
    for channel in recipe.channel:
        if channel.motion is None:
            continue
        try:
            found[channel.name] = delay_curve(in_steps(channel.motion, step_s), step_s)
        except ModelError:  # without process noise, say
            continue
    return found
