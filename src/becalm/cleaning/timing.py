"""Noise from an uncertain time of readings: R[k] = R - included^2 + (dx/dt std_s)^2.

Readings taken a little early or late err by the slope of the signal times the error of their time. The filter averages
that error like the rest of the noise, so that sigma grows by the root of R[k] / R, and not by the error itself.
Where the slope is small sigma does not shrink: an estimate there also depends on readings on the slopes next to it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.recipe import ChannelRecipe, Recipe
from becalm.cleaning.recipe_parts import TimingRecipe
from becalm.cleaning.slopes import Slopes
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.core.time.timebase import Timebase

_WORTH = 0.01  # of a step: a smaller rounding of stamps is ignored


def time_std_of(time: Timebase) -> float:
    """Return the standard uncertainty of rounded stamps, in seconds; 0 where they became an even grid."""
    rounded = time.resolution_s / np.sqrt(12.0)
    return 0.0 if time.uniform or rounded < _WORTH * time.step_s else float(rounded)


def with_timing(recipe: Recipe, recording: Recording, std_s: float, *, at_rest: bool) -> Recipe:
    """Return a recipe with the uncertainty of the time of readings.

    Parameters
    ----------
    recipe : Recipe
        Recipe that was tuned on the recording.
    recording : Recording
        Recording with its channels, and perhaps others.
    std_s : float
        Standard uncertainty (k = 1) of the time of each reading, independent of the others, in seconds.
    at_rest : bool
        Whether the noise was measured at rest, where an uncertain time adds nothing.
    """
    columns = [np.ascontiguousarray(recording.channel(channel.name)) for channel in recipe.channel]
    slopes = [0.0] * len(columns) if at_rest else _rms_slopes(recipe, columns, recording.timebase)
    pairs = zip(recipe.channel, slopes, strict=True)
    return recipe.model_copy(update={"channel": tuple(_with_timing(channel, std_s, slope) for channel, slope in pairs)})


def _rms_slopes(recipe: Recipe, columns: Sequence[Floats], time: Timebase) -> list[float]:
    with Cleaner(recipe, time.step_s) as cleaner:
        (estimates,) = [*cleaner.push(columns, time.elapsed_steps), *cleaner.finish()]
    slopes = (Slopes(time.step_s).of(channel.signal, time.elapsed_steps) for channel in estimates)
    return [float(np.sqrt(np.mean(slope**2))) for slope in slopes]


def _with_timing(channel: ChannelRecipe, std_s: float, rms_slope: float) -> ChannelRecipe:
    if channel.noise_std is None:
        return channel
    timing = TimingRecipe(std_s=std_s, included_std=min(channel.noise_std, std_s * rms_slope))
    return channel.model_copy(update={"timing": timing})
