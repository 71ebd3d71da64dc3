"""One channel on its way through a recipe, some rows at a time: filtered, or passed on as it is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import fields
from functools import partial
from typing import Any, Protocol

import numpy as np

from becalm.cleaning.faults import SensorWatch
from becalm.cleaning.figures import Figures, fixed_figures, mode_figures
from becalm.cleaning.filtered import FilteredChannel
from becalm.cleaning.holes import Holes
from becalm.cleaning.judging import Decision, InnovationJudge, Judgement
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.report import ChannelReport
from becalm.cleaning.steps import SOON
from becalm.core.arrays import Floats
from becalm.core.flow import Judge
from becalm.core.standing import Before, Rules, standing, standing_of_readings
from becalm.core.told import Told
from becalm.core.verdict import ADVICE, Verdict, counted
from becalm.noise.choose import FEWEST_READINGS
from becalm.noise.excess import excess_error

_NOTHING_REMOVED = "Next to nothing was removed: noise cannot be told from motion here, so noise_std is a guess."


class Channel(Protocol):
    """What takes the rows of one channel, and gives clean ones back, perhaps later."""

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take readings (B,) and the steps before them; return what is clean, in order."""
        ...

    def finish(self) -> list[Told]:
        """Return the rest."""
        ...

    def report(self) -> ChannelReport:
        """Say what was found, once finished."""
        ...

    def begin_after(self, before: Before) -> None:
        """Say what went before the rows that will be pushed."""
        ...

    def saved(self) -> dict[str, Any] | None:
        """Return what later rows of a causal filter depend on, as arrays; None where rows wait, and of any other."""
        ...

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        ...

    def standing(self) -> dict[str, Floats] | None:
        """Return what later rows depend on and nothing else, so that it can be compared; None where `saved` is."""
        ...

    @property
    def surely_alive(self) -> bool:
        """Whether no window of its innovations can have been one of a dead channel, wherever hops begin."""
        ...


def open_channel(
    recipe: ChannelRecipe, step_s: float, lag: int | None, split: bool = False, look: Judge | None = None
) -> Channel:
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

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take readings (B,) and the steps before them; return what is clean, in order."""
        if self._timing is not None:
            self._timing.push(elapsed)
        if self._holes is not None:
            self._holes.push(elapsed)
        usable, steps = self.sensor.push(z, elapsed)
        self._sentinel.push(usable)
        told = self._flow.push(usable, steps)
        return self._counted(told if self._holes is None else self._holes.bridged(told))

    def finish(self) -> list[Told]:
        """Return the rest."""
        usable, steps = self.sensor.finish()
        self._sentinel.push(usable)
        told = [*self._flow.push(usable, steps), *self._flow.finish()]
        return self._counted(told if self._holes is None else [*self._holes.bridged(told), *self._holes.finish()])

    def begin_after(self, before: Before) -> None:
        """Say what went before the rows that will be pushed."""
        self._flow.begin_after(before.reading, before.readings, before.steps)
        self.sensor.begin_after(before)

    def saved(self) -> dict[str, Any] | None:
        """Return what later rows of a causal filter depend on, as arrays; None where rows wait, and of any other."""
        held = self._flow.saved() if self._lag == 0 else None
        if held is None:
            return None
        timing = {} if self._timing is None else self._timing.saved()
        return held | self.sensor.saved() | self._sentinel.saved() | timing

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self._flow.restore(arrays)
        self.sensor.restore(arrays)
        self._sentinel.restore(arrays)
        if self._timing is not None:
            self._timing.restore(arrays)

    def standing(self) -> dict[str, Floats] | None:
        """Return what later rows depend on and nothing else, so that it can be compared; None where `saved` is."""
        held = self.saved()
        if held is None:
            return None
        gate, watch = self._runs.gate, self.sensor
        at_most = np.inf if gate is None else gate.at_most
        states, reach = len(self._runs.tuning.component.drift), self._runs.reach
        rules = Rules(states, reach, at_most, watch.stuck, watch.monitor.alarms, watch.remembers)
        timing = {} if self._timing is None else {"timing": held["timing_slopes"]}
        return standing(held, rules) | {"sentinel": held["sentinel"]} | timing

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
        tuning, figures = self._runs.tuning, self._figures()
        smooths = (self._lag is None or self._lag > SOON) and figures.removes_noise
        found = self._judge.judgement(partial(excess_error, tuning.counted_in(self._own)) if smooths else None)
        says = f"{found.says} {_NOTHING_REMOVED}" if figures.removes_nothing else found.says
        says = " ".join([says, *([] if self._timing is None else self._timing.says())])
        return ChannelReport(
            **_fields(found),
            name=self._recipe.name,
            unit=self._recipe.unit,
            model=self._recipe.model,
            order=tuning.order,
            tones_hz=self._tones_hz(disturbance=False),
            removed_hz=self._tones_hz(disturbance=True),
            noise_std=self._runs.noise_std,
            coloured_std=None if tuning.coloured is None else float(np.sqrt(tuning.coloured.variance)),
            q_over_r=tuning.ratio,
            bandwidth_hz=figures.bandwidth_hz,
            lag_s=figures.lag_s,
            delay_s=self._lag * self._step_s if self._lag else None,
            independence_s=figures.independence_s,
            tuning_spread=self._recipe.tuning_spread,
            calibration_std=self._uncertainty.calibration_std,
            timing_share=None if self._timing is None else self._timing.most,
            modes=figures.modes,
            log_likelihood=self._flow.log_likelihood,
            settled_row=self._flow.settled_row,
            verdicts=_named(self.counts),
            advice=(*_advice(self.counts), *self.sensor.advice()),
            faults=self.sensor.faults(),
            says=_with_advice(says, self.counts, self.sensor.says()),
        )

    def _figures(self) -> Figures:
        if self._runs.modes is not None:
            return mode_figures(self._runs.modes, self._flow.shares, self._step_s, self._lag)
        return fixed_figures(self._runs.tuning.counted_in(self._own), self._step_s * self._own, self._lag)

    def _tones_hz(self, *, disturbance: bool) -> tuple[float, ...]:
        return tuple(tone.frequency_hz for tone in self._recipe.tone if tone.disturbance == disturbance)


class UnchangedChannel:
    """A channel that is given back; of a constant or nearly empty one no uncertainty can be told."""

    def __init__(self, recipe: ChannelRecipe, step_s: float, split: bool) -> None:
        self._recipe, self._step_s, self._split, self._counts = recipe, step_s, split, Counter[Verdict]()
        self._sensor = SensorWatch(recipe.limits, step_s, shown=False)
        self._seen = 0
        self._first: float | None = None
        self._varies = False

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take readings (B,) and give them back."""
        readings, _ = self._sensor.push(z, elapsed)
        seen = readings[np.isfinite(readings)]
        self._seen += len(seen)
        if len(seen):
            self._first = float(seen[0]) if self._first is None else self._first
            self._varies = self._varies or bool(np.any(seen != self._first))
        unknown = np.full(len(z), np.nan)
        parts = np.tile(readings, (int(self._split), 1))
        told = self._sensor.named([Told(readings, unknown, parts, np.zeros(len(z), np.int8))])
        self._counts.update(counted(told[0].verdicts))
        return told

    def finish(self) -> list[Told]:
        """Return nothing: all was given back."""
        return []

    def begin_after(self, before: Before) -> None:
        """Say what went before the rows that will be pushed."""
        self._sensor.begin_after(before)

    def saved(self) -> dict[str, Any]:
        """Return what verdicts of later rows depend on, as arrays."""
        return self._sensor.saved()

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self._sensor.restore(arrays)

    def standing(self) -> dict[str, Floats]:
        """Return what verdicts of later rows depend on and nothing else, so that it can be compared."""
        return standing_of_readings(self.saved(), self._sensor.stuck, self._sensor.remembers)

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
            verdicts=_named(self._counts),
            advice=(*_advice(self._counts, but=Verdict.MISSING), *self._sensor.advice()),
            faults=self._sensor.faults(),
            says=_with_advice(says, self._counts, self._sensor.says(), but=Verdict.MISSING),
        )


def _fields(judgement: Judgement) -> dict[str, Any]:
    return {field.name: getattr(judgement, field.name) for field in fields(judgement) if field.name != "says"}


def _named(counts: Counter[Verdict]) -> dict[str, int]:
    return {verdict.name.lower(): counts[verdict] for verdict in Verdict}


def _advice(counts: Counter[Verdict], but: Verdict | None = None) -> tuple[str, ...]:
    """Say what to do about what a filter met; of faults the sensor's watch tells."""
    met = (Verdict.MISSING, Verdict.SPIKE, Verdict.STEP, Verdict.HOLE, Verdict.RUNAWAY)
    return tuple(ADVICE[verdict] for verdict in met if verdict != but and counts[verdict])


def _with_advice(says: str, counts: Counter[Verdict], faults: list[str], but: Verdict | None = None) -> str:
    return " ".join([says, *_advice(counts, but), *faults])
