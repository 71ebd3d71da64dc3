"""A channel that is filtered, but for its filter: what a file's and a stream's have in common."""

from __future__ import annotations

from collections import Counter

import numpy as np

from becalm.cleaning.faults import SensorWatch
from becalm.cleaning.modes import modes_in_steps
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.slopes import TimingNoise
from becalm.cleaning.steps import gate_of, in_steps
from becalm.cleaning.uncertainty import Uncertainty
from becalm.core.possible import largest_beside
from becalm.core.reach import Reach, least_reach, reach_of
from becalm.core.told import Told
from becalm.core.verdict import Verdict, counted


class FilteredChannel:
    """What filters of one channel are made of, and what is made of what they tell.

    Parameters
    ----------
    recipe : ChannelRecipe
        In seconds and units.
    step_s : float
        Step in seconds.

    Attributes
    ----------
    counts : Counter of Verdict
        How often each verdict was given.
    sensor : SensorWatch
        What is wrong with readings.

    Raises
    ------
    RecipeError
        If its numbers make no filter at this step.
    """

    def __init__(self, recipe: ChannelRecipe, step_s: float) -> None:
        assert recipe.motion is not None, "what has no motion passes unchanged"
        self._recipe, self._step_s, self._tuning = recipe, step_s, in_steps(recipe.motion, step_s)
        self.sensor, self.counts = SensorWatch(recipe.limits, step_s), Counter[Verdict]()
        self._uncertainty = Uncertainty(recipe.tuning_spread, recipe.calibration)
        self._gate = None if recipe.gate is None else gate_of(recipe.gate, step_s)
        modes = None if recipe.switching is None else modes_in_steps(recipe.switching, self._tuning, step_s)
        # the noise of a bank's reading is that of its calmest mode
        noise_std = recipe.motion.noise_std if modes is None else float(np.sqrt(modes.modes[0].noise_variance))
        self._modes, self._noise_std, timing = modes, noise_std, recipe.timing
        self._timing = None if timing is None else TimingNoise(timing, noise_std, step_s)

    def _bridged(self) -> tuple[Reach, float]:
        """Return which gaps the filter bridges, and the magnitude beyond which a value is no reading, in unit."""
        if self._modes is not None:
            reaches = [reach_of(mode.component, mode.noise_variance) for mode in self._modes.modes]
            return least_reach(reaches), largest_beside(self._modes.least_noise_variance)
        part, variance = self._tuning.component, self._tuning.noise_variance
        return reach_of(part, variance), largest_beside(variance)

    def _counted(self, told: list[Told]) -> list[Told]:
        """Return what a filter tells, with what else became of readings, and sigma as wide as it has to be."""
        told = self.sensor.named(told)
        for part in told:
            self.counts.update(counted(part.verdicts))
        if self._timing is not None:
            told = [self._timing.widened(part) for part in told]
        return self._uncertainty.widened(told)
