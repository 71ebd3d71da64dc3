"""tune(recording) -> Recipe and clean(recording, recipe) -> Cleaned: the main job."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from becalm.cleaning.judging import NOTHING_REMOVED, ChannelReport, judge_innovations
from becalm.cleaning.recipe import ChannelRecipe, Origin, Recipe, TunedMotion
from becalm.core.arrays import Floats
from becalm.core.components import motion
from becalm.core.filtering import run_filter
from becalm.core.recording import Recording
from becalm.core.response import Response, describe
from becalm.core.smoothing import run_smoother
from becalm.core.timebase import Timebase
from becalm.core.timeline import elapsed_timeline
from becalm.core.verdict import ADVICE, Judged, Verdict, judge
from becalm.errors import RecipeError, RecordingError
from becalm.noise.choose import FEWEST_READINGS, choose

Progress = Callable[[str], None]

_LEAST_RATIO, _GREATEST_RATIO = 1e-60, 1e12  # of q/r: beyond, every reading is ignored or believed


@dataclass(frozen=True)
class Cleaned:
    """A cleaned recording.

    Attributes
    ----------
    signal : Recording
        The clean channels, (N, m), same names, units and times.
    sigma : Recording
        One standard uncertainty of each sample, same units; NaN where none can be told.
    recipe : Recipe
        What was decided, enough to do it again.
    reports : tuple of ChannelReport
        What was found for each channel, and whether to trust it.
    """

    signal: Recording
    sigma: Recording
    recipe: Recipe
    reports: tuple[ChannelReport, ...]

    @property
    def describes(self) -> bool:
        """Whether every channel is described by its model."""
        return all(report.describes for report in self.reports)


def tune(
    recording: Recording,
    *,
    causal: bool = False,
    channels: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Recipe:
    """Identify the noise of each channel and choose its filter; nothing needs to be said.

    Parameters
    ----------
    recording : Recording
        Samples (N, m), NaN where missing.
    causal : bool
        Whether the recipe shall filter (True) or smooth.
    channels : sequence of str, optional
        Names of the channels to clean; all by default.
    progress : callable, optional
        Called with a channel's name when it is done.

    Raises
    ------
    RecordingError
        If a channel does not exist, or there are no channels or samples.
    """
    _refuse_empty(recording)
    chosen = recording if channels is None else recording.select(_listed(channels))
    _refuse_empty(chosen)
    one = partial(_tune_channel, chosen, causal, progress or _silent)
    with ThreadPoolExecutor() as pool:
        found = tuple(pool.map(one, chosen.names))
    origin = Origin(rows=len(chosen), rate_hz=chosen.rate_hz, becalm=version("becalm"))
    return Recipe(mode="causal" if causal else "smoothed", tuned_on=origin, channel=found)


def clean(
    recording: Recording,
    recipe: Recipe | None = None,
    *,
    causal: bool | None = None,
    channels: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Cleaned:
    """Clean a recording, by a recipe or by one found in it.

    Parameters
    ----------
    recording : Recording
        Samples (N, m), NaN where missing. Never modified.
    recipe : Recipe, optional
        What to do; `tune(recording)` by default.
    causal : bool, optional
        Whether estimates know only the past; False by default, or as the recipe says. A recipe tuned
        for the other mode keeps its numbers, which `tune(..., causal=...)` might choose differently.
    channels : sequence of str, optional
        Names of the channels to clean; all, or all of the recipe, by default.
    progress : callable, optional
        Called with a channel's name when a step of it is done.

    Raises
    ------
    RecordingError
        If a channel does not exist, or there are no channels or samples.
    RecipeError
        If the recipe names a channel that the recording does not have, or in another unit.
    """
    _refuse_empty(recording)
    if recipe is None:
        recipe = tune(recording, causal=bool(causal), channels=channels, progress=progress)
    else:
        recipe = _narrowed(recipe, causal, channels)
        _refuse_mismatch(recording, recipe)
    chosen = recording.select([channel.name for channel in recipe.channel])
    _refuse_empty(chosen)
    one = partial(_clean_channel, chosen, recipe.mode == "causal", progress or _silent)
    with ThreadPoolExecutor() as pool:
        parts = list(pool.map(one, recipe.channel))
    return Cleaned(
        chosen.with_samples(np.column_stack([part.signal for part in parts])),
        chosen.with_samples(np.column_stack([part.sigma for part in parts])),
        recipe,
        tuple(part.report for part in parts),
    )


class _Part(NamedTuple):
    signal: Floats
    sigma: Floats
    report: ChannelReport


def _tune_channel(recording: Recording, causal: bool, progress: Progress, name: str) -> ChannelRecipe:
    time, unit = recording.timebase, recording.units[recording.names.index(name)]
    choice = choose(judge(recording.channel(name)).readings, time.elapsed_steps, causal)
    progress(name)
    if choice.tuning is None:
        return ChannelRecipe(name=name, unit=unit, model=choice.kind)
    found = choice.tuning
    density = found.ratio * found.noise_variance / time.step_s ** (2 * found.order - 1)
    return ChannelRecipe(
        name=name,
        unit=unit,
        model="motion",
        order=found.order,
        process_noise_density=density,
        noise_std=float(np.sqrt(found.noise_variance)),
    )


def _clean_channel(recording: Recording, causal: bool, progress: Progress, channel: ChannelRecipe) -> _Part:
    judged = judge(recording.channel(channel.name))
    if channel.motion is None:
        part = _pass_unchanged(judged)
    else:
        part = _run_motion(judged, recording.timebase, channel.motion, causal)
    report = replace(part.report, name=channel.name, unit=channel.unit, model=channel.model)
    progress(channel.name)
    return part._replace(report=report)


def _pass_unchanged(judged: Judged) -> _Part:
    """Give the readings back; of a constant or nearly empty channel no uncertainty can be told."""
    seen = judged.readings[np.isfinite(judged.readings)]
    constant = len(seen) >= FEWEST_READINGS and bool(np.all(seen == seen[0]))
    if constant:
        says = "All readings are equal: the noise is below the resolution, or the sensor is stuck; sigma is unknown."
    elif len(seen) < FEWEST_READINGS:
        says = f"Fewer than {FEWEST_READINGS} readings cannot tell noise from signal; the channel passes unchanged."
    else:
        says = "The recipe passes this channel unchanged, but its readings vary; tune a recipe on this recording."
    report = ChannelReport(
        verdicts=judged.counts(),
        describes=constant,
        says=_with_advice(says, judged, but=Verdict.MISSING),
    )
    return _Part(judged.readings, np.full(len(judged.readings), np.nan), report)


def _run_motion(judged: Judged, time: Timebase, tuned: TunedMotion, causal: bool) -> _Part:
    variance, density = _per_step(tuned, time.step_s)
    component = motion(tuned.order, density)
    model = component.to_model(1.0, variance)
    timeline = elapsed_timeline(component, variance, time.elapsed_steps)
    z = judged.readings[:, np.newaxis]
    estimate = run_filter(model, timeline, z).estimate if causal else run_smoother(model, timeline, z)
    found = judge_innovations(estimate)
    response = describe(model, time.step_s, causal) if density > 0 else None
    report = ChannelReport(
        order=tuned.order,
        noise_std=tuned.noise_std,
        q_over_r=density / variance,
        bandwidth_hz=response.bandwidth_hz if response else 0.0,
        lag_s=response.lag_s if response else None,
        log_likelihood=estimate.log_likelihood,
        whiteness_p=found.whiteness_p,
        first_correlation=found.first_correlation,
        predictable_share=found.predictable_share,
        uneven_share=found.uneven_share,
        nis_mean=found.nis_mean,
        verdicts=judged.counts(),
        describes=found.describes,
        says=_with_advice(_with_reserve(found.says, response), judged),
    )
    return _Part(estimate.signal[:, 0], estimate.sigma[:, 0], report)


def _per_step(tuned: TunedMotion, step_s: float) -> tuple[float, float]:
    """Return the variance of a reading and the process noise in steps; both must be within float64's reach."""
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


def _with_reserve(says: str, response: Response | None) -> str:
    if response is None or response.noise_gain < NOTHING_REMOVED:
        return says
    return f"{says} Next to nothing was removed: noise cannot be told from motion here, so noise_std is a guess."


def _with_advice(says: str, judged: Judged, but: Verdict | None = None) -> str:
    counts = judged.counts()
    told = [ADVICE[verdict] for verdict in ADVICE if verdict != but and counts[verdict.name.lower()]]
    return " ".join([says, *told])


def _narrowed(recipe: Recipe, causal: bool | None, channels: Sequence[str] | None) -> Recipe:
    changes: dict[str, object] = {}
    if causal is not None:
        changes["mode"] = "causal" if causal else "smoothed"
    if channels is not None:
        known = {channel.name: channel for channel in recipe.channel}
        missing = [name for name in _listed(channels) if name not in known]
        if missing:
            raise RecipeError(f"The recipe has no channel {missing[0]!r}; it has {', '.join(map(repr, known))}.")
        changes["channel"] = tuple(known[name] for name in _listed(channels))
    return recipe.model_copy(update=changes)


def _refuse_mismatch(recording: Recording, recipe: Recipe) -> None:
    for channel in recipe.channel:
        if channel.name not in recording.names:
            raise RecipeError(
                f"The recipe cleans {channel.name!r}, but the recording has {', '.join(map(repr, recording.names))}."
                " Name the channels to clean, or tune a recipe on this recording."
            )
        unit = recording.units[recording.names.index(channel.name)]
        if channel.unit != unit:
            raise RecipeError(
                f"The recipe has {channel.name!r} in {channel.unit or 'no unit'!r}, the recording in"
                f" {unit or 'no unit'!r}. Convert one of them, or tune a recipe on this recording."
            )


def _refuse_empty(recording: Recording) -> None:
    if not isinstance(recording, Recording):
        raise RecordingError(
            f"A Recording is needed; {type(recording).__name__} came. Make one: becalm.Recording(samples, rate_hz=...)."
        )
    if not recording.names:
        raise RecordingError("No channel is left to clean; name at least one.")
    if not len(recording):
        raise RecordingError("The recording has no samples.")


def _listed(channels: Sequence[str]) -> list[str]:
    return [channels] if isinstance(channels, str) else list(channels)


def _silent(_: str) -> None:
    """Say nothing."""
