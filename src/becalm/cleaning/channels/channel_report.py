"""Build the report of a channel: the figures of its filter, the judgement of its model, and its sensor's faults."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.channels.faults import Findings
from becalm.cleaning.channels.figures import fixed_figures, mode_figures
from becalm.cleaning.channels.filters import Filter
from becalm.cleaning.channels.judging import InnovationJudge, Judgement
from becalm.cleaning.channels.report import ChannelReport
from becalm.cleaning.channels.slopes import timing_sentences
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.steps import SOON
from becalm.core.health.outlier_rule import MOST_OUTLIERS
from becalm.core.reading_verdicts import ADVICE, Verdict
from becalm.identification.trust.tuning_spread import excess_error

_NOTHING_REMOVED = "Next to nothing was removed: noise and motion cannot be distinguished here; noise_std is a guess."


class FilterResults(NamedTuple):
    """The results of a channel's filter, for its report."""

    filter: Filter
    counts: Counter[Verdict]
    findings: Findings
    judge: InnovationJudge
    shares: dict[str, float]  # mean probability of each mode, by its name
    calibration_std: float | None
    timing_share: float | None
    log_likelihood: float
    settled_row: int | None


def report_of(recipe: ChannelRecipe, step_s: float, lag: int | None, found: FilterResults) -> ChannelReport:
    """Return the report of a filtered channel; `lag` in rows, None for a smoother."""
    tuning, modes, own_steps = found.filter.tuning, found.filter.modes, recipe.own_steps(step_s)
    if modes is not None:
        figures = mode_figures(modes, found.shares, step_s, lag)
    else:
        figures = fixed_figures(tuning.counted_in(own_steps), step_s * own_steps, lag)
    smooths = (lag is None or lag > SOON) and figures.removes_noise
    judgement = found.judge.judgement(partial(excess_error, tuning.counted_in(own_steps)) if smooths else None)
    judgement = _reject_excessive_outliers(judgement, recipe, found.counts)
    says = f"{judgement.says} {_NOTHING_REMOVED}" if figures.removes_nothing else judgement.says
    says = " ".join([says, *timing_sentences(recipe.timing, found.timing_share or 0.0)])
    return ChannelReport(
        **_fields(judgement),
        name=recipe.name,
        unit=recipe.unit,
        model=recipe.model,
        order=tuning.order,
        tones_hz=_tones_hz(recipe, disturbance=False),
        removed_hz=_tones_hz(recipe, disturbance=True),
        noise_std=found.filter.noise_std,
        coloured_std=None if tuning.coloured is None else float(np.sqrt(tuning.coloured.variance)),
        q_over_r=tuning.ratio,
        bandwidth_hz=figures.bandwidth_hz,
        lag_s=figures.lag_s,
        delay_s=lag * step_s if lag else None,
        independence_s=figures.independence_s,
        tuning_spread=recipe.tuning_spread,
        calibration_std=found.calibration_std,
        timing_share=found.timing_share,
        modes=figures.modes,
        log_likelihood=found.log_likelihood,
        settled_row=found.settled_row,
        verdicts=counts_by_name(found.counts),
        advice=(*advice_for(found.counts), *found.findings.advice()),
        faults=found.findings.faults(),
        says=with_advice(says, found.counts, found.findings.says()),
    )


def _reject_excessive_outliers(judgement: Judgement, recipe: ChannelRecipe, counts: Counter[Verdict]) -> Judgement:
    """Return the judgement, or "does not fit" if more readings were left out than can be exceptions."""
    left_out, readings = counts[Verdict.OUTLIER] + counts[Verdict.CLIPPED], counts.total() - counts[Verdict.MISSING]
    marks_missing = recipe.limits is not None and recipe.limits.blank is not None
    if marks_missing or not judgement.describes or left_out <= MOST_OUTLIERS * readings:
        return judgement
    says = (
        f"The model does not describe this signal: {left_out} of {readings} readings were left out as outliers, or as"
        " clipped, which is too many for exceptions. Check whether these are real readings of the channel."
    )
    return replace(judgement, verdict="does not fit", says=says)


def _tones_hz(recipe: ChannelRecipe, *, disturbance: bool) -> tuple[float, ...]:
    return tuple(tone.frequency_hz for tone in recipe.tone if tone.disturbance == disturbance)


def _fields(judgement: Judgement) -> dict[str, Any]:
    return {field.name: getattr(judgement, field.name) for field in fields(judgement) if field.name != "says"}


def counts_by_name(counts: Counter[Verdict]) -> dict[str, int]:
    """Return how often each verdict was given, by the name of the verdict."""
    return {verdict.name.lower(): counts[verdict] for verdict in Verdict}


def advice_for(counts: Counter[Verdict], excluded: Verdict | None = None) -> tuple[str, ...]:
    """Return advice on a filter's verdicts, without `excluded`; `Findings.advice` is that on faults of the sensor."""
    verdicts = (Verdict.MISSING, Verdict.SPIKE, Verdict.STEP, Verdict.HOLE, Verdict.RUNAWAY)
    return tuple(ADVICE[verdict] for verdict in verdicts if verdict != excluded and counts[verdict])


def with_advice(says: str, counts: Counter[Verdict], faults: list[str], excluded: Verdict | None = None) -> str:
    """Return the text of a judgement, then the advice on all verdicts but `excluded`, then the sensor's faults."""
    return " ".join([says, *advice_for(counts, excluded), *faults])
