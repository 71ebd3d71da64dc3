"""Build the report of a channel: the figures of its filter, the judgement, and the faults of its sensor."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.faults import Findings
from becalm.cleaning.figures import fixed_figures, mode_figures
from becalm.cleaning.filters import Filter
from becalm.cleaning.judging import InnovationJudge, Judgement
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.report import ChannelReport
from becalm.cleaning.slopes import timing_sentences
from becalm.cleaning.steps import SOON
from becalm.core.health.outlier_rule import MOST_OUTLIERS
from becalm.core.reading_verdicts import ADVICE, Verdict
from becalm.identification.trust.tuning_spread import excess_error

_NOTHING_REMOVED = "Next to nothing was removed: noise and motion cannot be distinguished here; noise_std is a guess."


class FilterResults(NamedTuple):
    """The results of a channel's filter, for its report."""

    runs: Filter
    counts: Counter[Verdict]
    findings: Findings
    judged: InnovationJudge
    shares: dict[str, float]  # mean probability of each mode, by its name
    calibration_std: float | None
    timing_share: float | None
    log_likelihood: float
    settled_row: int | None


def report_of(recipe: ChannelRecipe, step_s: float, lag: int | None, found: FilterResults) -> ChannelReport:
    """Return the report of a channel that was filtered."""
    tuning, modes, own_steps = found.runs.tuning, found.runs.modes, recipe.own_steps(step_s)
    if modes is not None:
        figures = mode_figures(modes, found.shares, step_s, lag)
    else:
        figures = fixed_figures(tuning.counted_in(own_steps), step_s * own_steps, lag)
    smooths = (lag is None or lag > SOON) and figures.removes_noise
    judged = found.judged.judgement(partial(excess_error, tuning.counted_in(own_steps)) if smooths else None)
    judged = _doubted(judged, recipe, found.counts)
    says = f"{judged.says} {_NOTHING_REMOVED}" if figures.removes_nothing else judged.says
    says = " ".join([says, *timing_sentences(recipe.timing, found.timing_share or 0.0)])
    return ChannelReport(
        **_fields(judged),
        name=recipe.name,
        unit=recipe.unit,
        model=recipe.model,
        order=tuning.order,
        tones_hz=_tones_hz(recipe, disturbance=False),
        removed_hz=_tones_hz(recipe, disturbance=True),
        noise_std=found.runs.noise_std,
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
        verdicts=named(found.counts),
        advice=(*advice_on(found.counts), *found.findings.advice()),
        faults=found.findings.faults(),
        says=with_advice(says, found.counts, found.findings.says()),
    )


def _doubted(judged: Judgement, recipe: ChannelRecipe, counts: Counter[Verdict]) -> Judgement:
    """Return the judgement; "does not fit" if more readings were left out than can be outliers."""
    left_out, readings = counts[Verdict.OUTLIER] + counts[Verdict.CLIPPED], counts.total() - counts[Verdict.MISSING]
    fills_in = recipe.limits is not None and recipe.limits.blank is not None
    if fills_in or not judged.describes or left_out <= MOST_OUTLIERS * readings:
        return judged
    says = (
        f"The model does not describe this signal: {left_out} of {readings} readings were left out as outliers, or as"
        " clipped, which is too many for exceptions. Check whether these are real readings of the channel."
    )
    return replace(judged, verdict="does not fit", says=says)


def _tones_hz(recipe: ChannelRecipe, *, disturbance: bool) -> tuple[float, ...]:
    return tuple(tone.frequency_hz for tone in recipe.tone if tone.disturbance == disturbance)


def _fields(judgement: Judgement) -> dict[str, Any]:
    return {field.name: getattr(judgement, field.name) for field in fields(judgement) if field.name != "says"}


def named(counts: Counter[Verdict]) -> dict[str, int]:
    """Return how often each verdict was given, by its name."""
    return {verdict.name.lower(): counts[verdict] for verdict in Verdict}


def advice_on(counts: Counter[Verdict], but: Verdict | None = None) -> tuple[str, ...]:
    """Return what to do about a filter's verdicts, except `but`; `Findings` has the advice on faults of the sensor."""
    met = (Verdict.MISSING, Verdict.SPIKE, Verdict.STEP, Verdict.HOLE, Verdict.RUNAWAY)
    return tuple(ADVICE[verdict] for verdict in met if verdict != but and counts[verdict])


def with_advice(says: str, counts: Counter[Verdict], faults: list[str], but: Verdict | None = None) -> str:
    """Return the sentences of a judgement, followed by the advice on verdicts and by the faults of the sensor."""
    return " ".join([says, *advice_on(counts, but), *faults])
