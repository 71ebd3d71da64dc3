"""A channel that is filtered, but for its filter: what a file's and a stream's have in common."""

from __future__ import annotations

from collections import Counter

from becalm.cleaning.faults import SensorWatch
from becalm.cleaning.filters import Filter
from becalm.cleaning.limits_entry import limits_of, rows_that_judge
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.slopes import TimingNoise
from becalm.cleaning.uncertainty import Uncertainty
from becalm.core.health.sentinel import Sentinel
from becalm.core.rows import EstimatedRows
from becalm.core.verdict import Verdict, counted


class FilteredChannel:
    """What filters of one channel are made of, and what is made of what they tell.

    Parameters
    ----------
    recipe : ChannelRecipe
        In seconds and units.
    step_s : float
        Step in seconds.
    lag : int or None
        Later rows that each row waits for: 0 filters, None waits for all.

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

    def __init__(self, recipe: ChannelRecipe, step_s: float, lag: int | None) -> None:
        self._recipe, self._step_s, self._lag = recipe, step_s, lag
        self._runs = Filter(recipe, step_s, lag)
        ahead = rows_that_judge(recipe.limits, lag)
        self.sensor, self.counts = SensorWatch(recipe.limits, step_s, ahead=ahead), Counter[Verdict]()
        self._sentinel = Sentinel(limits_of(recipe.limits), recipe.unknown_from)
        self._uncertainty = Uncertainty(recipe.tuning_spread, recipe.calibration, recipe.limits)
        timing = recipe.timing
        self._timing = None if timing is None else TimingNoise(timing, self._runs.noise_std, step_s)

    def _counted(self, told: list[EstimatedRows]) -> list[EstimatedRows]:
        """Return what a filter tells, with what else became of readings, and sigma as wide as it has to be."""
        told = [self._sentinel.told(part) for part in self.sensor.named(told)]
        for part in told:
            self.counts.update(counted(part.verdicts))
        if self._timing is not None:
            told = [self._timing.widened(part) for part in told]
        return self._uncertainty.widened(told)
