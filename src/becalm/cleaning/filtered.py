"""The common base of filtered channels in files and in streams: all but the filter itself."""

from __future__ import annotations

from collections import Counter

from becalm.cleaning.faults import SensorWatch
from becalm.cleaning.filters import Filter
from becalm.cleaning.judging import Uncertainty
from becalm.cleaning.limits_entry import limits_of, rows_that_judge
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.slopes import TimingNoise
from becalm.core.health.sentinel import Sentinel
from becalm.core.rows import EstimatedRows
from becalm.core.verdict import Verdict, counted


class FilteredChannel:
    """Checks readings before a filter, and widens sigma and counts verdicts after it.

    Parameters
    ----------
    recipe : ChannelRecipe
        Its filter, in seconds and units.
    step_s : float
        One step, in seconds.
    lag : int or None
        Lag in rows: 0 for a causal filter, None for a smoother.

    Attributes
    ----------
    counts : Counter of Verdict
        How often each verdict was given.
    sensor : SensorWatch
        Finds faults of the readings.

    Raises
    ------
    RecipeError
        If its parameters do not make a valid filter at this step.
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

    def _counted(self, rows: list[EstimatedRows]) -> list[EstimatedRows]:
        """Return the rows of a filter with all verdicts, and with sigma widened by the other uncertainties."""
        rows = [self._sentinel.told(part) for part in self.sensor.named(rows)]
        for part in rows:
            self.counts.update(counted(part.verdicts))
        if self._timing is not None:
            rows = [self._timing.widened(part) for part in rows]
        return self._uncertainty.widened(rows)
