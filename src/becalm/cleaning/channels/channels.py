"""Clean one channel with a recipe, block by block: filter the readings, or pass them on unchanged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from becalm.cleaning.channels.causal_channel import CausalChannel, is_causal
from becalm.cleaning.channels.channel_report import FilterResults, advice_for, counts_by_name, report_of, with_advice
from becalm.cleaning.channels.faults import Findings, SensorWatch
from becalm.cleaning.channels.filters import Filter, FilteredChannel
from becalm.cleaning.channels.holes import Holes
from becalm.cleaning.channels.judging import Decision, InnovationJudge, Uncertainty
from becalm.cleaning.channels.report import ChannelReport
from becalm.cleaning.recipes.limits_entry import alarms_of
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.core.filter.channel import History, log_densities, parts_of
from becalm.core.filter.restarting_flow import RestartingFlow
from becalm.core.health.faults import possible_steps
from becalm.core.health.monitor import InnovationMonitor
from becalm.core.imm.flow import comparable_state
from becalm.core.reading_verdicts import Verdict, counted
from becalm.core.rows import EstimatedRows, Judge
from becalm.identification.choose import FEWEST_READINGS
from becalm.metrics.whiteness import Running

_PIECE = 1 << 16  # rows in one call of the innovation tests; with fewer, the calls take as long as the sums


class ChannelCleaner(Protocol):
    """A cleaner of one channel: it takes rows in blocks and returns their estimates at once or later."""

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and the steps since the previous row (B,); return the rows that are ready, in order."""
        ...

    def finish(self) -> list[EstimatedRows]:
        """Return the remaining rows."""
        ...

    def report(self) -> ChannelReport:
        """Return the report; call `finish` first."""
        ...

    def set_history(self, before: History) -> None:
        """Set the history before the first row that will be pushed."""
        ...

    def state_dict(self) -> dict[str, Any] | None:
        """Return the state of a causal filter as arrays; None for other filters, or while rows wait for later ones."""
        ...

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the state that `state_dict` returned."""
        ...

    def comparable_state(self) -> dict[str, Floats] | None:
        """Return the part of the state that later rows depend on, for comparison; None if `state_dict` returns None."""
        ...

    @property
    def surely_alive(self) -> bool:
        """Return whether no window of innovations so far looks dead, in whatever row the windows begin."""
        ...


def open_channel(
    recipe: ChannelRecipe, step_s: float, lag: int | None, split: bool = False, on_innovations: Judge | None = None
) -> ChannelCleaner:
    """Return the cleaner of a channel with this recipe.

    Parameters
    ----------
    recipe : ChannelRecipe
        Recipe of the channel, in seconds and units.
    step_s : float
        One step, in seconds.
    lag : int or None
        Lag in rows: 0 for a causal filter, None for a smoother.
    split : bool
        Whether to estimate the parts of the signal as well.
    on_innovations : callable, optional
        Called with the innovations (B,) and their standard deviations (B,), one value for each row.

    Raises
    ------
    RecipeError
        If the recipe's parameters do not make a valid filter at this step.
    """
    if recipe.motion is None:
        return UnchangedChannel(recipe, step_s, split)
    if is_causal(recipe, lag):
        return CausalChannelCleaner(recipe, step_s, split=split, on_innovations=on_innovations)
    return MotionChannel(recipe, step_s, lag=lag, split=split, on_innovations=on_innovations)


class MotionChannel(FilteredChannel):
    """A channel that is smoothed, filtered with a lag, or filtered with several modes."""

    def __init__(
        self, recipe: ChannelRecipe, step_s: float, *, lag: int | None, split: bool, on_innovations: Judge | None
    ) -> None:
        super().__init__(recipe, step_s, lag)
        self._on_innovations = on_innovations
        self._own_steps = recipe.own_steps(step_s)
        self._judge = InnovationJudge(step_s * self._own_steps, scores=recipe.switching is not None)
        self._flow = self._filter.open_flow(self._add_innovations, split=split)
        self._holes = Holes(recipe.hole, self._own_steps) if lag is None and recipe.hole else None

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and the steps since the previous row (B,); return the rows that are ready, in order."""
        elapsed = possible_steps(elapsed)
        if self._timing is not None:
            self._timing.push(elapsed)
        if self._holes is not None:
            self._holes.push(elapsed)
        usable, steps = self.sensor.push(z, elapsed)
        self._sentinel.push(usable)
        rows = self._flow.push(usable, steps)
        return self._counted(rows if self._holes is None else self._holes.corrected(rows))

    def finish(self) -> list[EstimatedRows]:
        """Return the remaining rows."""
        usable, steps = self.sensor.finish()
        self._sentinel.push(usable)
        rows = [*self._flow.push(usable, steps), *self._flow.finish()]
        return self._counted(rows if self._holes is None else [*self._holes.corrected(rows), *self._holes.finish()])

    def set_history(self, before: History) -> None:
        """Set the history before the first row that will be pushed."""
        self._flow.set_history(before.reading, before.readings, before.steps)
        self.sensor.set_history(before)

    def state_dict(self) -> dict[str, Any] | None:
        """Return the state of a causal filter as arrays; None for other filters, or while rows wait for later ones."""
        state = self._flow.state_dict() if self._lag == 0 and isinstance(self._flow, RestartingFlow) else None
        if state is None:
            return None
        timing = {} if self._timing is None else self._timing.state_dict()
        return state | self.sensor.state_dict() | self._sentinel.state_dict() | timing

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the state that `state_dict` returned."""
        assert isinstance(self._flow, RestartingFlow), "only the state of a `RestartingFlow` can be saved"
        self._flow.load_state_dict(arrays)
        self.sensor.load_state_dict(arrays)
        self._sentinel.load_state_dict(arrays)
        if self._timing is not None:
            self._timing.load_state_dict(arrays)

    def comparable_state(self) -> dict[str, Floats] | None:
        """Return the part of the state that later rows depend on, for comparison; None if `state_dict` returns None."""
        state = self.state_dict()
        if state is None:
            return None
        timing = {} if self._timing is None else {"timing": state["timing_slopes"]}
        return (
            comparable_state(state, self._filter.gap_limit)
            | self.sensor.comparable_state()
            | {"sentinel": state["sentinel"]}
            | timing
        )

    @property
    def surely_alive(self) -> bool:
        """Return whether no window of innovations so far looks dead, in whatever row the windows begin."""
        return self.sensor.monitor.aliveness.sure

    def _add_innovations(self, innovations: Floats, innovation_sigma: Floats) -> None:
        self._judge.add(innovations, innovation_sigma)
        self.sensor.add_innovations(innovations, innovation_sigma)
        if self._on_innovations is not None:
            self._on_innovations(innovations, innovation_sigma)

    def report(self) -> ChannelReport:
        """Return the report; call `finish` first."""
        results = FilterResults(
            self._filter,
            self.counts,
            self.sensor.findings,
            self._judge,
            self._flow.shares,
            self._uncertainty.calibration_std,
            None if self._timing is None else self._timing.largest_share,
            self._flow.log_likelihood,
            self._flow.settled_row,
        )
        return report_of(self._recipe, self._step_s, self._lag, results)


class CausalChannelCleaner:
    """A cleaner of a channel with one causal filter, without modes."""

    def __init__(self, recipe: ChannelRecipe, step_s: float, *, split: bool, on_innovations: Judge | None) -> None:
        self._recipe, self._step_s, self._split, self._on_innovations = recipe, step_s, split, on_innovations
        self._filter, self._own_steps = Filter(recipe, step_s, 0), recipe.own_steps(step_s)
        self._channel = CausalChannel(recipe, step_s)
        self._judge, self._monitor = (
            InnovationJudge(step_s * self._own_steps),
            InnovationMonitor(alarms_of(recipe.limits)),
        )
        self._log_likelihood = Running(0.0, _add_log_densities)
        self._uncertainty = Uncertainty(recipe.tuning_spread, recipe.calibration, recipe.limits)
        self._counts, self._rows = Counter[Verdict](), 0

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and the steps since the previous row (B,); return the rows that are ready, in order."""
        estimates = self._channel.process(z, elapsed, states=self._split)
        for start in range(0, len(z), _PIECE):
            piece = slice(start, start + _PIECE)
            self._add_innovations(estimates.innovation[piece], estimates.deviation[piece], elapsed[piece])
        self._rows += len(z)
        self._counts.update(counted(estimates.verdict))
        self._uncertainty.add_magnitudes(estimates.signal)
        rows = estimates.to_rows()
        if not self._split:
            return [rows]
        return [rows._replace(parts=parts_of(self._channel.settings.component, estimates))]

    def finish(self) -> list[EstimatedRows]:
        """Return no rows: `push` returned all of them."""
        return []

    def set_history(self, before: History) -> None:
        """Set the history before the first row that will be pushed."""
        self._channel.set_history(before)
        self._monitor.set_history(before.readings, before.rows, before.steps)

    def state_dict(self) -> dict[str, Any]:
        """Return the state as arrays."""
        return self._channel.state_dict() | self._monitor.state_dict()

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the state that `state_dict` returned."""
        self._channel.load_state_dict(arrays)
        self._channel.filter.reset_counts()
        self._monitor.load_state_dict(arrays)

    def comparable_state(self) -> dict[str, Any]:
        """Return the part of the state that later rows depend on, for comparison."""
        return self._channel.comparable_state()

    @property
    def surely_alive(self) -> bool:
        """Return whether no window of innovations so far looks dead, in whatever row the windows begin."""
        return self._monitor.aliveness.sure

    def report(self) -> ChannelReport:
        """Return the report; call `finish` first."""
        causal = self._channel.filter
        findings = Findings(self._channel.settings.limits, self._step_s, self._rows, causal.faults, self._monitor)
        results = FilterResults(
            self._filter,
            self._counts,
            findings,
            self._judge,
            shares={},
            calibration_std=self._uncertainty.calibration_std,
            timing_share=None if self._recipe.timing is None else causal.timing_share,
            log_likelihood=self._log_likelihood.sums(),
            settled_row=causal.settled_row,
        )
        return report_of(self._recipe, self._step_s, 0, results)

    def _add_innovations(self, innovation: Floats, deviation: Floats, elapsed: Floats) -> None:
        self._judge.add(innovation, deviation)
        self._monitor.push(innovation / deviation, elapsed)
        self._log_likelihood.add(log_densities(innovation, deviation))
        if self._on_innovations is not None:
            self._on_innovations(innovation, deviation)


class UnchangedChannel:
    """A channel whose readings pass unchanged because it is constant or nearly empty; its sigma is NaN."""

    def __init__(self, recipe: ChannelRecipe, step_s: float, split: bool) -> None:
        self._recipe, self._step_s, self._split, self._counts = recipe, step_s, split, Counter[Verdict]()
        self._sensor = SensorWatch(recipe.limits, step_s, has_innovations=False)
        self._count = 0
        self._first: float | None = None
        self._varies = False

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and return them; a faulty reading becomes NaN and gets a verdict."""
        readings, _ = self._sensor.push(z, elapsed)
        finite = readings[np.isfinite(readings)]
        self._count += len(finite)
        if len(finite):
            self._first = float(finite[0]) if self._first is None else self._first
            self._varies = self._varies or bool(np.any(finite != self._first))
        unknown = np.full(len(z), np.nan)
        parts = np.tile(readings, (int(self._split), 1))
        rows = self._sensor.with_verdicts([EstimatedRows(readings, unknown, parts, np.zeros(len(z), np.int8))])
        self._counts.update(counted(rows[0].verdicts))
        return rows

    def finish(self) -> list[EstimatedRows]:
        """Return no rows: `push` returned all of them."""
        return []

    def set_history(self, before: History) -> None:
        """Set the history before the first row that will be pushed."""
        self._sensor.set_history(before)

    def state_dict(self) -> dict[str, Any]:
        """Return the state that later verdicts depend on, as arrays."""
        return self._sensor.state_dict()

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the state that `state_dict` returned."""
        self._sensor.load_state_dict(arrays)

    def comparable_state(self) -> dict[str, Floats]:
        """Return the part of the state that later verdicts depend on, for comparison."""
        return self._sensor.comparable_state()

    surely_alive = True
    """The channel has no innovations, so that no window of innovations can look dead."""

    def report(self) -> ChannelReport:
        """Report whether the channel is constant, nearly empty, or should have been filtered."""
        count = self._count
        constant = count >= FEWEST_READINGS and not self._varies
        verdict: Decision = "does not fit"
        says = "The recipe passes this channel unchanged, but its readings vary; tune a recipe on this recording."
        if constant:
            verdict = "constant"
            says = (
                "All readings are equal: the noise is below the resolution, or the sensor is stuck; sigma is unknown."
            )
        elif count < FEWEST_READINGS:
            verdict = "untold"
            says = f"Fewer than {FEWEST_READINGS} readings do not identify the noise; the channel passes unchanged."
        elif self._recipe.model == "untold":
            verdict = "untold"
            says = "Its readings come in stretches too short to identify the noise; the channel passes unchanged."
        return ChannelReport(
            verdict=verdict,
            name=self._recipe.name,
            unit=self._recipe.unit,
            model=self._recipe.model,
            verdicts=counts_by_name(self._counts),
            advice=(*advice_for(self._counts, excluded=Verdict.MISSING), *self._sensor.findings.advice()),
            faults=self._sensor.findings.faults(),
            says=with_advice(says, self._counts, self._sensor.findings.says(), excluded=Verdict.MISSING),
        )


def _add_log_densities(sum_so_far: float, more: Floats) -> float:
    return sum_so_far + float(more.sum())
