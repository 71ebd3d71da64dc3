"""The specification of an exported bank: becalm's own stream of one channel, in even time."""

from __future__ import annotations

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipe_parts import LimitsRecipe
from becalm.cleaning.stream import StreamCleaner, Streamed
from becalm.core.arrays import Codes, Floats
from becalm.core.verdict import BEYOND_ANY_SENSOR
from becalm.export.design import NOT_IN_C

_AT_ONCE = 1 << 16  # rows


class BankReference:
    """One channel.

    Parameters
    ----------
    recipe : ChannelRecipe
        Of a channel that switches; what only widens sigma, or tells of more than one reading, is left out.
    step_s : float
        One step, in seconds.
    largest : float
        Magnitude beyond which a value is no reading, in unit.
    """

    def __init__(self, recipe: ChannelRecipe, step_s: float, largest: float) -> None:
        told = Recipe(mode="causal", tuned_on=Origin(rate_hz=1 / step_s), channel=(_plain(recipe, largest),))
        self._stream = StreamCleaner(told, step_s)

    def run(self, readings: Floats) -> tuple[Floats, Codes]:
        """Take readings (B,); return the signal, 0 where nothing is known yet, and what became of each."""
        told = self.push(readings)
        signal, codes = told.signal[:, 0], told.verdicts[:, 0]
        return np.where(np.isnan(signal), 0.0, signal), codes.astype(np.int8)

    def gap(self, rows: int) -> None:
        """Go on for some rows without a reading, each a step of its own."""
        for first in range(0, rows, _AT_ONCE):
            self.push(np.full(min(_AT_ONCE, rows - first), np.nan))

    def push(self, readings: Floats) -> Streamed:
        """Take readings (B,); return all that is told of them."""
        return self._stream.push(readings[:, np.newaxis], np.ones(len(readings)))


def _plain(recipe: ChannelRecipe, largest: float) -> ChannelRecipe:
    """Return a recipe with what the exported filter knows."""
    limits = recipe.limits or LimitsRecipe()
    known = {
        "drift_threshold": None,
        "dead_variance": None,
        "even_time": None,
        "gap_steps": None,
        **dict.fromkeys(NOT_IN_C),
        "largest": min(largest, BEYOND_ANY_SENSOR),
    }
    beside = {"tuning_spread": 0.0, "calibration": None, "timing": None, "limits": limits.model_copy(update=known)}
    beside["fill"] = True
    return recipe.model_copy(update=beside)
