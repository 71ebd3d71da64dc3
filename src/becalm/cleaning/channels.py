"""One channel on its way through a recipe, some rows at a time: filtered, or passed on as it is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from becalm.cleaning.causal_channel import CausalChannel, is_causal
from becalm.cleaning.channel_report import Filtered, advice_on, named, report_of, with_advice
from becalm.cleaning.faults import Findings, SensorWatch
from becalm.cleaning.filtered import FilteredChannel
from becalm.cleaning.filters import Filter
from becalm.cleaning.holes import Holes
from becalm.cleaning.judging import Decision, InnovationJudge
from becalm.cleaning.limits_entry import alarms_of
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.report import ChannelReport
from becalm.cleaning.uncertainty import Uncertainty
from becalm.core.arrays import Floats
from becalm.core.filter.channel import History, log_densities, parts_of
from becalm.core.filter.restarting_flow import RestartingFlow
from becalm.core.health.monitor import InnovationMonitor
from becalm.core.health.time_faults import possible_steps
from becalm.core.imm.comparable_state import comparable_state
from becalm.core.rows import EstimatedRows, Judge
from becalm.core.verdict import Verdict, counted
from becalm.identification.choose import FEWEST_READINGS
from becalm.metrics.running import Running

_PIECE = 1 << 16  # rows whose innovations are judged at once: of fewer, calls take as long as sums


class ChannelCleaner(Protocol):
    """What takes the rows of one channel, and gives clean ones back, perhaps later."""

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and the steps before them; return what is clean, in order."""
        ...

    def finish(self) -> list[EstimatedRows]:
        """Return the rest."""
        ...

    def report(self) -> ChannelReport:
        """Say what was found, once finished."""
        ...

    def begin_after(self, before: History) -> None:
        """Say what went before the rows that will be pushed."""
        ...

    def saved(self) -> dict[str, Any] | None:
        """Return what later rows of a causal filter depend on, as arrays; None where rows wait, and of any other."""
        ...

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        ...

    def comparable_state(self) -> dict[str, Floats] | None:
        """Return what later rows depend on and nothing else, so that it can be compared; None where `saved` is."""
        ...

    @property
    def surely_alive(self) -> bool:
        """Whether no window of its innovations can have been one of a dead channel, wherever hops begin."""
        ...


def open_channel(
    recipe: ChannelRecipe, step_s: float, lag: int | None, split: bool = False, look: Judge | None = None
) -> ChannelCleaner:
    """Start a channel as its recipe says.

    Parameters
    ----------
    recipe : ChannelRecipe
        In seconds and units.
    step_s : float
        Step in seconds.
    lag : int or None
        Later rows that each row waits for: 0 filters, None waits for all.
    split : bool
        Whether to tell the parts of the signal as well.
    look : callable, optional
        Is given the innovations (B,) too, and their standard deviations, a value a row.

    Raises
    ------
    RecipeError
        If its numbers make no filter at this step.
    """
    if recipe.motion is None:
        return UnchangedChannel(recipe, step_s, split)
    if is_causal(recipe, lag):
        return CausalMotion(recipe, step_s, split=split, look=look)
    return MotionChannel(recipe, step_s, lag=lag, split=split, look=look)


class MotionChannel(FilteredChannel):
    """A channel that is filtered."""

    def __init__(
        self, recipe: ChannelRecipe, step_s: float, *, lag: int | None, split: bool, look: Judge | None
    ) -> None:
        super().__init__(recipe, step_s, lag)
        self._also = look
        self._own = recipe.own_steps(step_s)
        self._judge = InnovationJudge(step_s * self._own, scores=recipe.switching is not None)
        self._flow = self._runs.opened(self._look, split=split)
        self._holes = Holes(recipe.hole, self._own) if lag is None and recipe.hole else None

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and the steps before them; return what is clean, in order."""
        elapsed = possible_steps(elapsed)
        if self._timing is not None:
            self._timing.push(elapsed)
        if self._holes is not None:
            self._holes.push(elapsed)
        usable, steps = self.sensor.push(z, elapsed)
        self._sentinel.push(usable)
        told = self._flow.push(usable, steps)
        return self._counted(told if self._holes is None else self._holes.bridged(told))

    def finish(self) -> list[EstimatedRows]:
        """Return the rest."""
        usable, steps = self.sensor.finish()
        self._sentinel.push(usable)
        told = [*self._flow.push(usable, steps), *self._flow.finish()]
        return self._counted(told if self._holes is None else [*self._holes.bridged(told), *self._holes.finish()])

    def begin_after(self, before: History) -> None:
        """Say what went before the rows that will be pushed."""
        self._flow.begin_after(before.reading, before.readings, before.steps)
        self.sensor.begin_after(before)

    def saved(self) -> dict[str, Any] | None:
        """Return what later rows of a causal filter depend on, as arrays; None where rows wait, and of any other."""
        held = self._flow.saved() if self._lag == 0 and isinstance(self._flow, RestartingFlow) else None
        if held is None:
            return None
        timing = {} if self._timing is None else self._timing.saved()
        return held | self.sensor.saved() | self._sentinel.saved() | timing

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        assert isinstance(self._flow, RestartingFlow), "nothing else is saved"
        self._flow.restore(arrays)
        self.sensor.restore(arrays)
        self._sentinel.restore(arrays)
        if self._timing is not None:
            self._timing.restore(arrays)

    def comparable_state(self) -> dict[str, Floats] | None:
        """Return what later rows depend on and nothing else, so that it can be compared; None where `saved` is."""
        held = self.saved()
        if held is None:
            return None
        timing = {} if self._timing is None else {"timing": held["timing_slopes"]}
        return (
            comparable_state(held, self._runs.gap_limit)
            | self.sensor.comparable_state()
            | {"sentinel": held["sentinel"]}
            | timing
        )

    @property
    def surely_alive(self) -> bool:
        """Whether no window of its innovations can have been one of a dead channel, wherever hops begin."""
        return self.sensor.monitor.aliveness.sure

    def _look(self, innovations: Floats, innovation_sigma: Floats) -> None:
        self._judge.add(innovations, innovation_sigma)
        self.sensor.look(innovations, innovation_sigma)
        if self._also is not None:
            self._also(innovations, innovation_sigma)

    def report(self) -> ChannelReport:
        """Say what was found, once finished."""
        found = Filtered(
            self._runs,
            self.counts,
            self.sensor.findings,
            self._judge,
            self._flow.shares,
            self._uncertainty.calibration_std,
            None if self._timing is None else self._timing.most,
            self._flow.log_likelihood,
            self._flow.settled_row,
        )
        return report_of(self._recipe, self._step_s, self._lag, found)


class CausalMotion:
    """A channel that is one causal filter."""

    def __init__(self, recipe: ChannelRecipe, step_s: float, *, split: bool, look: Judge | None) -> None:
        self._recipe, self._step_s, self._split, self._also = recipe, step_s, split, look
        self._runs, self._own = Filter(recipe, step_s, 0), recipe.own_steps(step_s)
        self._channel = CausalChannel(recipe, step_s)
        self._judge, self._monitor = InnovationJudge(step_s * self._own), InnovationMonitor(alarms_of(recipe.limits))
        self._log_likelihood = Running(0.0, _with_log_densities)
        self._uncertainty = Uncertainty(recipe.tuning_spread, recipe.calibration, recipe.limits)
        self._counts, self._rows = Counter[Verdict](), 0

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and the steps before them; return what is clean, in order."""
        found = self._channel.process(z, elapsed, states=self._split)
        for start in range(0, len(z), _PIECE):
            piece = slice(start, start + _PIECE)
            self._look(found.innovation[piece], found.deviation[piece], elapsed[piece])
        self._rows += len(z)
        self._counts.update(counted(found.verdict))
        self._uncertainty.see(found.signal)
        parts = parts_of(self._channel.settings.component, found) if self._split else found.told().parts
        return [found.told()._replace(parts=parts)]

    def finish(self) -> list[EstimatedRows]:
        """Return nothing: all was given back."""
        return []

    def begin_after(self, before: History) -> None:
        """Say what went before the rows that will be pushed."""
        self._channel.begin_after(before)
        self._monitor.begin_after(before.readings, before.rows, before.steps)

    def saved(self) -> dict[str, Any]:
        """Return what later rows depend on, as arrays."""
        return self._channel.state_dict() | self._monitor.saved()

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self._channel.load_state_dict(arrays)
        self._channel.filter.forget_counts()
        self._monitor.restore(arrays)

    def comparable_state(self) -> dict[str, Any]:
        """Return what later rows depend on and nothing else, so that it can be compared."""
        return self._channel.comparable_state()

    @property
    def surely_alive(self) -> bool:
        """Whether no window of its innovations can have been one of a dead channel, wherever hops begin."""
        return self._monitor.aliveness.sure

    def report(self) -> ChannelReport:
        """Say what was found, once finished."""
        own = self._channel.filter
        findings = Findings(self._channel.settings.limits, self._step_s, self._rows, own.faults, self._monitor)
        found = Filtered(
            self._runs,
            self._counts,
            findings,
            self._judge,
            shares={},
            calibration_std=self._uncertainty.calibration_std,
            timing_share=None if self._recipe.timing is None else own.timing_share,
            log_likelihood=self._log_likelihood.sums(),
            settled_row=own.settled_row,
        )
        return report_of(self._recipe, self._step_s, 0, found)

    def _look(self, innovation: Floats, deviation: Floats, elapsed: Floats) -> None:
        self._judge.add(innovation, deviation)
        self._monitor.push(innovation / deviation, elapsed)
        self._log_likelihood.add(log_densities(innovation, deviation))
        if self._also is not None:
            self._also(innovation, deviation)


class UnchangedChannel:
    """A channel that is given back; of a constant or nearly empty one no uncertainty can be told."""

    def __init__(self, recipe: ChannelRecipe, step_s: float, split: bool) -> None:
        self._recipe, self._step_s, self._split, self._counts = recipe, step_s, split, Counter[Verdict]()
        self._sensor = SensorWatch(recipe.limits, step_s, shown=False)
        self._seen = 0
        self._first: float | None = None
        self._varies = False

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and give them back."""
        readings, _ = self._sensor.push(z, elapsed)
        seen = readings[np.isfinite(readings)]
        self._seen += len(seen)
        if len(seen):
            self._first = float(seen[0]) if self._first is None else self._first
            self._varies = self._varies or bool(np.any(seen != self._first))
        unknown = np.full(len(z), np.nan)
        parts = np.tile(readings, (int(self._split), 1))
        told = self._sensor.named([EstimatedRows(readings, unknown, parts, np.zeros(len(z), np.int8))])
        self._counts.update(counted(told[0].verdicts))
        return told

    def finish(self) -> list[EstimatedRows]:
        """Return nothing: all was given back."""
        return []

    def begin_after(self, before: History) -> None:
        """Say what went before the rows that will be pushed."""
        self._sensor.begin_after(before)

    def saved(self) -> dict[str, Any]:
        """Return what verdicts of later rows depend on, as arrays."""
        return self._sensor.saved()

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self._sensor.restore(arrays)

    def comparable_state(self) -> dict[str, Floats]:
        """Return what verdicts of later rows depend on and nothing else, so that it can be compared."""
        return self._sensor.comparable_state()

    surely_alive = True
    """No filter is asked."""

    def report(self) -> ChannelReport:
        """Say whether the channel is constant, or nearly empty, or should have been filtered."""
        seen = self._seen
        constant = seen >= FEWEST_READINGS and not self._varies
        verdict: Decision = "does not fit"
        says = "The recipe passes this channel unchanged, but its readings vary; tune a recipe on this recording."
        if constant:
            verdict = "constant"
            says = (
                "All readings are equal: the noise is below the resolution, or the sensor is stuck; sigma is unknown."
            )
        elif seen < FEWEST_READINGS:
            verdict = "untold"
            says = f"Fewer than {FEWEST_READINGS} readings cannot tell noise from signal; the channel passes unchanged."
        elif self._recipe.model == "untold":
            verdict = "untold"
            says = "Its readings come in stretches too short to tell noise from signal; the channel passes unchanged."
        return ChannelReport(
            verdict=verdict,
            name=self._recipe.name,
            unit=self._recipe.unit,
            model=self._recipe.model,
            verdicts=named(self._counts),
            advice=(*advice_on(self._counts, but=Verdict.MISSING), *self._sensor.findings.advice()),
            faults=self._sensor.findings.faults(),
            says=with_advice(says, self._counts, self._sensor.findings.says(), but=Verdict.MISSING),
        )


def _with_log_densities(sum_so_far: float, more: Floats) -> float:
    return sum_so_far + float(more.sum())
