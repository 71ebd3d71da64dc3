"""One channel on its way through a recipe, some rows at a time: filtered, or passed on as it is."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Protocol

import numpy as np

from becalm.cleaning.judging import NOTHING_REMOVED, ChannelReport, InnovationJudge
from becalm.cleaning.recipe import ChannelRecipe, TunedMotion
from becalm.core.arrays import Floats
from becalm.core.components import Component, motion, oscillator
from becalm.core.flow import Flow, Told
from becalm.core.model import Model
from becalm.core.response import Response, describe
from becalm.core.verdict import ADVICE, Verdict, judge
from becalm.errors import ModelError, RecipeError
from becalm.noise.choose import FEWEST_READINGS

_QUICKEST, _WIDEST = 0.5, 10.0  # cycles a step
_LEAST_RATIO, _GREATEST_RATIO = 1e-60, 1e12  # of q/r: beyond, every reading is ignored or believed


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


def open_channel(recipe: ChannelRecipe, step_s: float, causal: bool) -> Channel:
    """Start a channel as its recipe says.

    Raises
    ------
    RecipeError
        If its numbers make no filter at this step.
    """
    return UnchangedChannel(recipe) if recipe.motion is None else MotionChannel(recipe, recipe.motion, step_s, causal)


class MotionChannel:
    """A channel that is filtered."""

    def __init__(self, recipe: ChannelRecipe, tuned: TunedMotion, step_s: float, causal: bool) -> None:
        self._recipe, self._tuned, self._step_s, self._causal = recipe, tuned, step_s, causal
        self._variance, self._density = per_step(tuned, step_s)
        self._judge, self._counts = InnovationJudge(step_s), Counter[Verdict]()
        self._component = sum(_tones(tuned, step_s), motion(tuned.order, self._density))
        self._flow = Flow(self._component, self._variance, causal=causal, judge=self._judge.add)

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take readings (B,) and the steps before them; return what is clean, in order."""
        judged = judge(z)
        self._counts.update(judged.counts)
        return self._flow.push(judged.readings, elapsed)

    def finish(self) -> list[Told]:
        """Return the rest."""
        return self._flow.finish()

    def report(self) -> ChannelReport:
        """Say what was found, once finished."""
        found, tuned = self._judge.judgement(), self._tuned
        model = self._component.to_model(1.0, self._variance)
        response = _response(model, self._step_s, self._causal)
        return ChannelReport(
            name=self._recipe.name,
            unit=self._recipe.unit,
            model=self._recipe.model,
            order=tuned.order,
            tones_hz=tuple(tone.frequency_hz for tone in tuned.tones),
            noise_std=tuned.noise_std,
            q_over_r=self._density / self._variance,
            bandwidth_hz=response.bandwidth_hz if response else 0.0,
            lag_s=response.lag_s if response else None,
            log_likelihood=self._flow.log_likelihood,
            settled_row=self._flow.settled_row,
            whiteness_p=found.whiteness_p,
            first_correlation=found.first_correlation,
            predictable_share=found.predictable_share,
            loudest_hz=found.loudest_hz,
            uneven_share=found.uneven_share,
            nis_mean=found.nis_mean,
            verdicts=_named(self._counts),
            describes=found.describes,
            says=_with_advice(_with_reserve(found.says, response), self._counts),
        )


class UnchangedChannel:
    """A channel that is given back; of a constant or nearly empty one no uncertainty can be told."""

    def __init__(self, recipe: ChannelRecipe) -> None:
        self._recipe, self._counts = recipe, Counter[Verdict]()
        self._first: float | None = None
        self._varies = False

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take readings (B,) and give them back."""
        judged = judge(z)
        self._counts.update(judged.counts)
        seen = judged.readings[np.isfinite(judged.readings)]
        if len(seen):
            self._first = float(seen[0]) if self._first is None else self._first
            self._varies = self._varies or bool(np.any(seen != self._first))
        return [Told(judged.readings, np.full(len(z), np.nan))]

    def finish(self) -> list[Told]:
        """Return nothing: all was given back."""
        return []

    def report(self) -> ChannelReport:
        """Say whether the channel is constant, or nearly empty, or should have been filtered."""
        seen = self._counts[Verdict.USED]
        constant = seen >= FEWEST_READINGS and not self._varies
        if constant:
            says = (
                "All readings are equal: the noise is below the resolution, or the sensor is stuck; sigma is unknown."
            )
        elif seen < FEWEST_READINGS:
            says = f"Fewer than {FEWEST_READINGS} readings cannot tell noise from signal; the channel passes unchanged."
        else:
            says = "The recipe passes this channel unchanged, but its readings vary; tune a recipe on this recording."
        report = ChannelReport(name=self._recipe.name, unit=self._recipe.unit, model=self._recipe.model)
        counts = replace(report, verdicts=_named(self._counts), describes=constant)
        return replace(counts, says=_with_advice(says, self._counts, but=Verdict.MISSING))


def per_step(tuned: TunedMotion, step_s: float) -> tuple[float, float]:
    """Return the variance of a reading and the process noise in steps.

    Raises
    ------
    RecipeError
        If one of them is out of float64's reach.
    """
    with np.errstate(all="ignore"):
        variance = float(np.float64(tuned.noise_std) ** 2)
        density = float(np.float64(tuned.process_noise_density) * np.float64(step_s) ** (2 * tuned.order - 1))
    possible = 1e-250 < variance < 1e250 and (density == 0 or _LEAST_RATIO < density / variance < _GREATEST_RATIO)
    if not possible or (density == 0 and tuned.process_noise_density > 0):
        raise RecipeError(
            f"process_noise_density = {tuned.process_noise_density:.3g} and noise_std = {tuned.noise_std:.3g} make"
            f" no filter at {1 / step_s:.6g} Hz; mend them in the recipe, or tune one on this recording."
        )
    return variance, density


def _tones(tuned: TunedMotion, step_s: float) -> list[Component]:
    """Return the tones in steps.

    Raises
    ------
    RecipeError
        If one is too quick or too wide to be read at this rate, or drowns the noise.
    """
    variance = tuned.noise_std**2
    for tone in tuned.tones:
        ratio = tone.process_noise_density * step_s / variance
        if not (tone.frequency_hz * step_s < _QUICKEST and tone.bandwidth_hz * step_s < _WIDEST):
            raise RecipeError(
                f"The recipe has a tone at {tone.frequency_hz:.6g} Hz, {tone.bandwidth_hz:.6g} Hz wide, which"
                f" {1 / step_s:.6g} readings a second cannot tell; leave it out, or tune a recipe on this recording."
            )
        if not _LEAST_RATIO < ratio < _GREATEST_RATIO:
            raise RecipeError(
                f"The tone at {tone.frequency_hz:.6g} Hz with process_noise_density = {tone.process_noise_density:.3g}"
                f" and noise_std = {tuned.noise_std:.3g} makes no filter at {1 / step_s:.6g} Hz; mend the recipe."
            )
    return [
        oscillator(tone.frequency_hz * step_s, tone.bandwidth_hz * step_s, tone.process_noise_density * step_s)
        for tone in tuned.tones
    ]


def _response(model: Model, step_s: float, causal: bool) -> Response | None:
    """Describe a filter; None of one that never forgets its start, and so never settles."""
    try:
        return describe(model, step_s, causal)
    except ModelError:
        return None


def _named(counts: Counter[Verdict]) -> dict[str, int]:
    return {verdict.name.lower(): counts[verdict] for verdict in Verdict}


def _with_reserve(says: str, response: Response | None) -> str:
    if response is None or response.noise_gain < NOTHING_REMOVED:
        return says
    return f"{says} Next to nothing was removed: noise cannot be told from motion here, so noise_std is a guess."


def _with_advice(says: str, counts: Counter[Verdict], but: Verdict | None = None) -> str:
    return " ".join([says, *(ADVICE[verdict] for verdict in ADVICE if verdict != but and counts[verdict])])
