"""Build the filter of a channel from its recipe, for runs over a whole record or over a part of it."""

from __future__ import annotations

from collections import Counter
from functools import cached_property, partial

import numpy as np

from becalm.cleaning.channels.faults import SensorWatch
from becalm.cleaning.channels.figures import modes_in_steps
from becalm.cleaning.channels.judging import Uncertainty
from becalm.cleaning.channels.slopes import TimingNoise
from becalm.cleaning.recipes.limits_entry import limits_of, outlier_test_rows, smoothing_rows
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.steps import gate_of, in_steps
from becalm.core.arrays import BLOCK
from becalm.core.filter.channel_settings import GapLimit, gap_limit_of, least_gap_limit
from becalm.core.filter.fixed_lag_flow import FixedLagFlow
from becalm.core.filter.restarting_flow import CausalFlow, PartialFlow, RestartingFlow
from becalm.core.filter.smoothed_flow import SmoothedFlow
from becalm.core.health.sentinel import Sentinel
from becalm.core.imm.fixed_lag_flow import FixedLagImmFlow, rows_between
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels
from becalm.core.model.parts import largest_magnitude_for_noise
from becalm.core.reading_verdicts import Verdict, counted
from becalm.core.rows import EstimatedRows, Judge
from becalm.core.steady.steady_filter import NEGLIGIBLE_SHARE, rows_until_decayed
from becalm.identification.likelihood import Tuning


class Filter:
    """The filter of a channel, with time in steps; `open_flow` starts a run.

    Parameters
    ----------
    recipe : ChannelRecipe
        Recipe with a motion, in seconds and units.
    step_s : float
        One step, in seconds.
    lag : int or None
        Lag in rows: 0 for a causal filter, None for a smoother.

    Attributes
    ----------
    tuning : Tuning
        Parameters of the filter, in steps.
    modes : InteractingModels or None
        Modes of the filter, if it has several.
    lag : int or None
        Number of later rows that the filter smooths with; None for all. The outlier test before the filter uses the
        other rows of the recipe's lag.
    gate : Gate or None
        The gate that rejects spikes.
    noise_variance : float
        Noise variance of a reading, in unit^2; with several modes, the least of their variances.
    noise_std : float
        Standard deviation of a reading's noise, in unit; with several modes, that of the first mode.
    gap_limit : GapLimit
        Longest gaps that the filter predicts across; after longer gaps it restarts.
    largest : float
        Largest magnitude of a valid reading, in unit.

    Raises
    ------
    RecipeError
        If the recipe's parameters do not make a valid filter at this step.
    """

    def __init__(self, recipe: ChannelRecipe, step_s: float, lag: int | None) -> None:
        assert recipe.motion is not None, "a channel that passes unchanged has no filter"
        self.tuning: Tuning = in_steps(recipe.motion, step_s)
        self.modes = None if recipe.switching is None else modes_in_steps(recipe.switching, self.tuning, step_s)
        self.lag = smoothing_rows(recipe.limits, lag)
        self.gate = None if recipe.gate is None else gate_of(recipe.gate, step_s)
        if self.modes is not None:
            self.noise_variance, self.gap_limit = self.modes.least_noise_variance, _gap_limit_of_modes(self.modes)
            self.noise_std = float(np.sqrt(self.modes.modes[0].noise_variance))
        else:
            self.noise_variance, self.noise_std = self.tuning.noise_variance, recipe.motion.noise_std
            self.gap_limit = gap_limit_of(self.tuning.component, self.noise_variance)
        self.largest_magnitude = largest_magnitude_for_noise(self.noise_variance)

    def open_flow(
        self, judge: Judge | None = None, *, split: bool = False
    ) -> RestartingFlow | SmoothedFlow | FixedLagFlow:
        """Start a run; `judge` gets the innovations, and with `split` the parts of the signal are estimated too.

        A causal filter without modes cannot be run so: `CausalChannel` and `CausalFlow` run it.
        """
        if self.modes is not None:
            return RestartingFlow(
                partial(self._open_modes, self.modes, judge, split), self.gap_limit, self.largest_magnitude
            )
        component, variance = self.tuning.component, self.noise_variance
        if self.lag is None:
            return SmoothedFlow(component, variance, judge=judge, split=split, gate=self.gate)
        assert self.lag, "a causal filter without modes is a `CausalChannel`"
        return FixedLagFlow(component, variance, lag=self.lag, judge=judge, split=split, gate=self.gate)

    def open_signal_flow(self) -> RestartingFlow | SmoothedFlow | FixedLagFlow | CausalFlow:
        """Start a run that estimates only signal and sigma, for any filter."""
        if self.lag == 0 and self.modes is None:
            return CausalFlow(self.tuning.component, self.noise_variance, self.gate)
        return self.open_flow()

    @property
    def row_multiple(self) -> int:
        """Return n such that a run over a part of a record must start in row 0, n, 2n, ..."""
        return rows_between(self.lag) if self.lag and self.modes is not None else BLOCK

    @cached_property
    def readings_to_forget(self) -> float:
        """Return the number of readings after which the effect of a run's start is negligible; inf if it never is.

        For a smoother this is also the number of readings before the end of a run that its end affects.
        """
        if self.modes is None:
            return rows_until_decayed(NEGLIGIBLE_SHARE, self.tuning.component.to_model(1.0, self.noise_variance))
        models = [mode.component.to_model(1.0, mode.noise_variance) for mode in self.modes.modes]
        return max(rows_until_decayed(NEGLIGIBLE_SHARE, model) for model in models)

    def _open_modes(self, modes: InteractingModels, judge: Judge | None, split: bool) -> PartialFlow:
        if self.lag:
            return FixedLagImmFlow(modes, lag=self.lag, judge=judge, split=split)
        return ImmFlow(modes, causal=self.lag == 0, judge=judge, split=split)


def _gap_limit_of_modes(modes: InteractingModels) -> GapLimit:
    """Return the longest gaps that all modes of an IMM may predict across."""
    return least_gap_limit([gap_limit_of(mode.component, mode.noise_variance) for mode in modes.modes])


# Check readings before the filter of a channel, and widen sigma after it, in files and in streams.


class FilteredChannel:
    """The base class of a filtered channel: it checks readings, and widens sigma and counts verdicts after the filter.

    Parameters
    ----------
    recipe : ChannelRecipe
        Recipe of the channel, in seconds and units.
    step_s : float
        One step, in seconds.
    lag : int or None
        Lag in rows: 0 for a causal filter, None for a smoother.

    Attributes
    ----------
    counts : Counter of Verdict
        How often each verdict was given.
    sensor : SensorWatch
        Check of the readings for faults.

    Raises
    ------
    RecipeError
        If the recipe's parameters do not make a valid filter at this step.
    """

    def __init__(self, recipe: ChannelRecipe, step_s: float, lag: int | None) -> None:
        self._recipe, self._step_s, self._lag = recipe, step_s, lag
        self._filter = Filter(recipe, step_s, lag)
        ahead = outlier_test_rows(recipe.limits, lag)
        self.sensor, self.counts = SensorWatch(recipe.limits, step_s, ahead=ahead), Counter[Verdict]()
        self._sentinel = Sentinel(limits_of(recipe.limits), recipe.hole_sigma)
        self._uncertainty = Uncertainty(recipe.tuning_spread, recipe.calibration, recipe.limits)
        timing = recipe.timing
        self._timing = None if timing is None else TimingNoise(timing, self._filter.noise_std, step_s)

    def _counted(self, rows: list[EstimatedRows]) -> list[EstimatedRows]:
        """Return the filter's rows with all verdicts, and with sigma widened for tuning, calibration and time."""
        rows = [self._sentinel.mark_implausible(part) for part in self.sensor.with_verdicts(rows)]
        for part in rows:
            self.counts.update(counted(part.verdicts))
        if self._timing is not None:
            rows = [self._timing.widened(part) for part in rows]
        return self._uncertainty.widened(rows)
