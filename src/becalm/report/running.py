"""Clean a recording in memory and draw its figures."""

from __future__ import annotations

import numpy as np

from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.recording import Recording
from becalm.report.channel import CleanedChannels, Pictures
from becalm.report.gathering import Gathering


def pictures_of(recording: Recording, recipe: Recipe) -> Pictures:
    """Clean a recording with a recipe, and return its figures.

    Parameters
    ----------
    recording : Recording
        Samples (N, m), with the recipe's channels.
    recipe : Recipe
        Recipe from `clean` or from `tune`.

    Raises
    ------
    RecordingError
        If the recording lacks a channel of the recipe.
    RecipeError
        If the numbers of a channel do not give a filter at the recording's rate.
    """
    names = [channel.name for channel in recipe.channel]
    chosen, time = recording.select(names), recording.timebase
    columns = [np.ascontiguousarray(chosen.channel(name)) for name in names]
    gathering = Gathering(len(chosen), time.step_s, len(names))
    looks = [channel.add_innovations for channel in gathering.channels]
    with Cleaner(recipe, time.step_s, innovation_callbacks=looks) as cleaner:
        for estimates in (*cleaner.push(columns, time.elapsed_steps), *cleaner.finish()):
            gathering.add(columns, time.elapsed_steps, estimates)
        return Pictures(CleanedChannels(recipe, cleaner.reports(), gathering, time.step_s))
