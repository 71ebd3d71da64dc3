"""Tune a recipe on a recording: identify the noise of each channel and choose its filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from numbers import Real
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from becalm.cleaning.alarms import with_alarms
from becalm.cleaning.channels.faults import find_healthy
from becalm.cleaning.channels.figures import modes_in_seconds
from becalm.cleaning.channels.slopes import Slopes
from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.errors_in_holes import measure_hole_corrections
from becalm.cleaning.recipes.limits_entry import with_rounding
from becalm.cleaning.recipes.recipe import ChannelRecipe, Mode, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import CalibrationRecipe, GateRecipe, TareRecipe, TimingRecipe
from becalm.cleaning.recipes.steps import SOON, checked_lag_s, gate_of, in_seconds, lag_in_rows
from becalm.core.arrays import Floats
from becalm.core.model.parts import checked_number
from becalm.core.recording import Recording
from becalm.core.time.timebase import Timebase
from becalm.errors import RecordingError, UsageError
from becalm.identification.at_rest.detection import rests_in_spans
from becalm.identification.choose import Choice, PriorKnowledge
from becalm.identification.coloured import NoiseModel, fit_noise
from becalm.identification.damping import spread_std
from becalm.identification.gating import choose_gated, forecasts
from becalm.identification.imputation import nearly_complete
from becalm.identification.likelihood import FEWEST_FOR_TONES, Evidence, Tuning
from becalm.identification.modes.switching import IdentifiedImm, choose_robust, find_switching
from becalm.identification.tones import MOST_TONES
from becalm.identification.trust.tuning_spread import tuning_spread
from becalm.identification.wishes.dial import Dial, may_gate, tune_by_dial
from becalm.installation import load_scipy, version

if TYPE_CHECKING:
    from becalm.sensors.record import Calibration

# Noise from an uncertain time of readings: R[k] = R - included^2 + (dx/dt std_s)^2.
#
# A reading that is taken too early or too late has an error: the slope of the signal times the error of its time. The
# filter averages this error like all other noise. Sigma is thus multiplied by the root of R[k] / R, and this error is
# not added to it. Where the slope is small, sigma does not shrink, because the estimate also depends on readings nearby
# where the slope may be large.

_LEAST_STD_STEPS = 0.01  # least standard deviation of rounded stamps, in steps, that is not ignored


def time_std_of(time: Timebase) -> float:
    """Return the standard uncertainty of rounded stamps, in seconds; 0 if it is negligible, or the times are even."""
    std_s = time.resolution_s / np.sqrt(12.0)
    return 0.0 if time.uniform or std_s < _LEAST_STD_STEPS * time.step_s else float(std_s)


def with_timing(recipe: Recipe, recording: Recording, std_s: float, *, at_rest: bool) -> Recipe:
    """Return the recipe with the uncertainty of the times of readings added.

    Parameters
    ----------
    recipe : Recipe
        Recipe that was tuned on the recording.
    recording : Recording
        Recording that has the recipe's channels, and perhaps others.
    std_s : float
        Standard uncertainty (k = 1) of the time of each reading, in seconds; the errors are independent.
    at_rest : bool
        Whether the noise was measured at rest, where an uncertain time adds no noise.
    """
    columns = [np.ascontiguousarray(recording.channel(channel.name)) for channel in recipe.channel]
    slopes = [0.0] * len(columns) if at_rest else _rms_slopes(recipe, columns, recording.timebase)
    pairs = zip(recipe.channel, slopes, strict=True)
    return recipe.model_copy(update={"channel": tuple(_with_timing(channel, std_s, slope) for channel, slope in pairs)})


def _rms_slopes(recipe: Recipe, columns: Sequence[Floats], time: Timebase) -> list[float]:
    """Return the root mean square slope of each clean channel, in unit/s."""
    with Cleaner(recipe, time.step_s) as cleaner:
        (estimates,) = [*cleaner.push(columns, time.elapsed_steps), *cleaner.finish()]
    slopes = (Slopes(time.step_s).of(channel.signal, time.elapsed_steps) for channel in estimates)
    return [float(np.sqrt(np.mean(slope**2))) for slope in slopes]


def _with_timing(channel: ChannelRecipe, std_s: float, rms_slope: float) -> ChannelRecipe:
    if channel.noise_std is None:
        return channel
    timing = TimingRecipe(std_s=std_s, included_std=min(channel.noise_std, std_s * rms_slope))
    return channel.model_copy(update={"timing": timing})


_LEAST_SPREAD = 1e-120  # least difference of readings that is not lost when it is squared, in any unit
_NEARLY_EMPTY = 64  # a channel with fewer readings raises no error if too few of them are at rest

Progress = Callable[[str], None]


class Wishes(NamedTuple):
    """The options of a tuning, which a person sets; all other parameters are identified from the recording.

    Attributes
    ----------
    dial : Dial or None
        A lag, a bandwidth or a noise gain that every filter must have.
    still_s : tuple of (float, float)
        Stretches in which the sensor lay still, to measure the noise there: start and end of each, in seconds after the
        first row.
    rest : Recording or None
        Recording of the same channels, to which `still_s` refers; by default the recording that the recipe is tuned on.
    removed_hz : tuple of float
        Frequencies of tones to remove, such as mains hum.
    lag_s : float or None
        How long each estimate may wait for later readings, in seconds; with a *small* lag estimates come sooner, but
        are noisier.
    robust : bool
        Whether to choose a filter for readings of which 1 to 10 % are outliers, which the filter leaves out.
    fill : bool
        Whether to return an estimate even in holes in which the model predicts nothing.
    time_std_s : float or None
        Standard uncertainty (k = 1) of the time of each reading, such as the jitter of the sampling clock, in seconds;
        the errors are independent. With None it is that of the rounding of the stamps, or 0 for even times.
    """

    dial: Dial | None = None
    still_s: tuple[tuple[float, float], ...] = ()
    rest: Recording | None = None
    removed_hz: tuple[float, ...] = ()
    lag_s: float | None = None
    robust: bool = False
    time_std_s: float | None = None
    fill: bool = False


NO_WISHES = Wishes()


class ChannelTuning(NamedTuple):
    """The result of tuning one channel."""

    channel: ChannelRecipe  # the tuned recipe
    choice: Choice  # the chosen model, and the models that it was compared with
    evidence: Evidence  # the readings that the channel was tuned on


class Tuned(NamedTuple):
    """A tuned recipe, and the tuning results of its channels."""

    recipe: Recipe
    found: tuple[ChannelTuning, ...]


def tune(
    recording: Recording,
    *,
    causal: bool = False,
    channels: Sequence[str] | None = None,
    wishes: Wishes = NO_WISHES,
    progress: Progress | None = None,
) -> Recipe:
    """Identify the noise of each channel and choose its filter; every option has a default.

    Parameters
    ----------
    recording : Recording
        Samples (N, m), NaN where missing.
    causal : bool
        Whether the recipe is for a causal filter (True) or a smoother.
    channels : sequence of str, optional
        Names of the channels to clean; all by default.
    wishes : Wishes
        Options; by default all parameters are identified from the recording.
    progress : callable, optional
        Called with the name of each channel that is done.

    Raises
    ------
    RecordingError
        If a channel does not exist, there are no channels or samples, or the stretches of `still_s` have too few
        samples.
    UsageError
        If no filter can meet the dial, wishes contradict each other, or the lag is shorter than one step or too long.
    """
    return explore(recording, causal=causal, channels=channels, wishes=wishes, progress=progress).recipe


def explore(
    recording: Recording,
    *,
    causal: bool = False,
    channels: Sequence[str] | None = None,
    wishes: Wishes = NO_WISHES,
    progress: Progress | None = None,
) -> Tuned:
    """Tune as `tune` does; also return the model choice and the readings of each channel."""
    refuse_empty(recording)
    chosen = recording if channels is None else recording.select(as_list(channels))
    refuse_empty(chosen)
    refuse_causal_lag(causal, None)
    wishes = _checked_wishes(wishes, chosen.timebase)
    _refuse_contradictions(wishes, chosen)
    as_filter = tuned_as_filter(causal, wishes.lag_s, chosen.timebase.step_s)
    one = partial(_tune_channel, chosen, as_filter, wishes, progress or _ignore_progress)
    load_scipy()
    pool = ThreadPoolExecutor()
    try:
        found = tuple(pool.map(one, chosen.names))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)  # after an interruption, do not wait for the other channels
    origin = Origin(rows=len(chosen), rate_hz=chosen.rate_hz, becalm=version())
    mode: Mode = "causal" if causal else "smoothed" if wishes.lag_s is None else "lagged"
    recipe = Recipe(mode=mode, lag_s=wishes.lag_s, tuned_on=origin, channel=tuple(one.channel for one in found))
    std_s = time_std_of(chosen.timebase) if wishes.time_std_s is None else wishes.time_std_s
    return Tuned(with_timing(recipe, chosen, std_s, at_rest=bool(wishes.still_s)) if std_s else recipe, found)


def _tune_channel(recording: Recording, causal: bool, wishes: Wishes, progress: Progress, name: str) -> ChannelTuning:
    tuned = _identify_channel(recording, causal, wishes, name)
    if not causal and wishes.lag_s is None and tuned.channel.motion is not None:
        hole = measure_hole_corrections(tuned.channel, tuned.evidence, recording.timebase.step_s)
        tuned = tuned._replace(channel=tuned.channel.model_copy(update={"hole": hole}))
    progress(name)
    return tuned


def _identify_channel(recording: Recording, causal: bool, wishes: Wishes, name: str) -> ChannelTuning:
    time, unit = recording.timebase, recording.units[recording.names.index(name)]
    prior = PriorKnowledge(
        _rest_noise(wishes.rest or recording, name, wishes.still_s) if wishes.still_s else None,
        tuple(2 * np.pi * frequency * time.step_s for frequency in wishes.removed_hz),
    )
    gate_recipe, elapsed = GateRecipe(), time.elapsed_steps
    gate = gate_of(gate_recipe, time.step_s)
    readings, outliers, limits = find_healthy(recording.channel(name), elapsed, time.step_s, causal=causal)
    spread = float(np.nanmax(readings) - np.nanmin(readings)) if np.isfinite(readings).any() else 0.0
    if 0 < spread < _LEAST_SPREAD:
        raise RecordingError(
            f"{name}: the readings differ by {spread:.3g} at most, whose square is beyond float64; give another unit."
        )
    choice, gated = choose_gated(readings, elapsed, gate, causal, prior)
    evidence = Evidence.of(readings, elapsed)
    if choice.tuning is None or choice.motion is None:
        return ChannelTuning(ChannelRecipe(name=name, unit=unit, model=choice.kind, limits=limits), choice, evidence)
    tuning, spread = choice.tuning, 0.0
    if wishes.dial is not None:
        tuning = tune_by_dial(choice.motion, wishes.dial, time.step_s, causal)
        gated = gated and may_gate(tuning, choice.tuning)
    unknown = {"spread_std": spread_std(evidence), "fill": wishes.fill}
    limits = with_rounding(limits, tuning, readings, causal=causal)
    predicted = forecasts(tuning, readings, elapsed, gate if gated else None)
    if wishes.dial is None:  # a dial sets the filter: its tuning has no spread, and modes must not replace it
        if not wishes.still_s and not wishes.removed_hz:
            spikes = None if wishes.robust else bool(predicted.rejected.any())
            all_readings = Evidence.of(np.where(np.isfinite(outliers), outliers, readings), elapsed)
            own = evidence.own_step
            usable, with_outliers = evidence.counted_in(own), all_readings.counted_in(own)
            imm = _identify_imm(tuning.counted_in(own), usable, causal, spikes, with_outliers)
            if imm is not None:
                modes = modes_in_seconds(imm.kind, imm.switching, own * time.step_s)
                channel = in_seconds(name, unit, imm.tuning.counted_in(1 / own), time.step_s)
                more = {"switching": modes, "limits": limits, **unknown}
                return ChannelTuning(channel.model_copy(update=more), choice, evidence)
        evidence = Evidence.of(np.where(predicted.rejected, np.nan, readings), elapsed) if gated else evidence
        own = 1.0 if tuning.coloured else evidence.own_step
        steps = tuning.counted_in(own), evidence.counted_in(own)
        spread = tuning_spread(*steps, causal, noise_known=prior.noise is not None)
    limits = with_alarms(limits, tuning, predicted.normalised, causal=causal, step_s=time.step_s)
    own_hz = 1 / (evidence.own_step * time.step_s) if evidence.own_step > 1 and not tuning.coloured else None
    others = {"gate": gate_recipe if gated else None, "limits": limits, "rate_hz": own_hz, **unknown}
    return ChannelTuning(
        in_seconds(name, unit, tuning, time.step_s, spread).model_copy(update=others), choice, evidence
    )


def _identify_imm(
    tuning: Tuning, evidence: Evidence, causal: bool, spikes: bool | None, with_outliers: Evidence
) -> IdentifiedImm | None:
    """Identify the modes of a channel; return None if a fixed filter is as good.

    `spikes` is whether a gate rejects readings of the channel, or None if a robust filter is wanted.
    """
    if spikes is None:
        return choose_robust(tuning, evidence, causal)
    return find_switching(tuning, evidence, causal, spikes, with_outliers)


def _rest_noise(rest: Recording, name: str, still_s: Sequence[tuple[float, float]]) -> NoiseModel | None:
    """Return a channel's noise at rest, all of it as white noise if times are uneven; None if it cannot be measured."""
    elapsed = rest.timebase.elapsed_steps
    readings = find_healthy(rest.channel(name), elapsed, rest.timebase.step_s).readings
    parts = [slice(*stretch) for stretch in rests_in_spans(rest, still_s).stretches]
    if not any(np.nanstd(readings[part]) > 0 for part in parts if np.isfinite(readings[part]).any()):
        return None
    try:
        noise = fit_noise([readings[part] for part in parts])
    except RecordingError as cause:
        if np.isfinite(readings).sum() < _NEARLY_EMPTY:
            return None  # the noise of a nearly empty channel is identified without rests
        raise RecordingError(f"{name}: {cause}") from cause
    even = all(np.array_equal(elapsed[part][1:], np.round(elapsed[part][1:])) for part in parts)
    if even or noise.coloured is None:
        return noise
    return NoiseModel(noise.white_variance + noise.coloured.variance, None, noise.drift_density, noise.count)


def _checked_wishes(wishes: Wishes, time: Timebase) -> Wishes:
    """Return the wishes with numbers as float; raise an error if one of them is of a wrong type or impossible."""
    if not isinstance(wishes, Wishes):
        raise UsageError(f"Wishes are needed; {wishes!r:.60} came. Make some: becalm.Wishes(lag_s=0.01).")
    dial: object = wishes.dial
    if dial is not None and not (isinstance(dial, Dial) and isinstance(dial.value, Real)):
        raise UsageError(f"dial = {dial!r:.60} is not a Dial; give one, as in Dial('bandwidth_hz', 5.0).")
    if wishes.rest is not None:
        refuse_empty(wishes.rest)
    try:  # + 0.0 refuses text, which float would read
        still_s = tuple((float(from_s + 0.0), float(to_s + 0.0)) for from_s, to_s in wishes.still_s)
    except (TypeError, ValueError, OverflowError) as cause:
        raise UsageError(
            f"still_s = {wishes.still_s!r:.60} is not a tuple of stretches; give from and to of each, in seconds, as in"
            " still_s=((0, 10),)."
        ) from cause
    try:
        removed_hz = tuple(float(frequency_hz + 0.0) for frequency_hz in wishes.removed_hz)
    except (TypeError, ValueError, OverflowError) as cause:
        raise UsageError(
            f"removed_hz = {wishes.removed_hz!r:.60} is not a tuple of frequencies; give them as in removed_hz=(50.0,)."
        ) from cause
    std_s, longest_s = wishes.time_std_s, max(time.duration_s, time.step_s)
    if std_s is not None:
        std_s = checked_number("time_std_s", std_s, "an uncertainty of times", "a number of seconds", zero=True)
        if std_s > longest_s:
            raise UsageError(f"time_std_s = {std_s:.6g} is longer than the record, {longest_s:.6g} s; give seconds.")
    lag_s = None if wishes.lag_s is None else checked_lag_s(wishes.lag_s)
    return wishes._replace(still_s=still_s, removed_hz=removed_hz, time_std_s=std_s, lag_s=lag_s)


def _refuse_contradictions(wishes: Wishes, recording: Recording) -> None:
    removed, rate_hz = wishes.removed_hz, recording.rate_hz
    if wishes.robust and (wishes.dial is not None or wishes.still_s or removed):
        raise UsageError("A robust filter has no dial, rests or tones; ask for one thing at a time.")
    if removed and (wishes.dial is not None or wishes.still_s):
        raise UsageError("Tones are removed only if the recording decides everything else; ask for one at a time.")
    if len(removed) > MOST_TONES:
        raise UsageError(f"{len(removed)} tones to remove are too many; give up to {MOST_TONES}.")
    if removed and not all(0 < frequency < rate_hz / 2 for frequency in removed):
        raise UsageError(
            f"Tones to remove must be between 0 and {rate_hz / 2:.6g} Hz, half of the rate;"
            f" {', '.join(f'{frequency:.6g}' for frequency in removed)} Hz came."
        )
    if removed and _longest_even(recording) < FEWEST_FOR_TONES:
        raise UsageError(
            f"To remove tones, {FEWEST_FOR_TONES} rows at an even rate without a gap are needed;"
            f" {'no stretch is so even' if len(recording) >= FEWEST_FOR_TONES else f'{len(recording)} rows came'}."
            " Give a longer recording, or give the rate of the rows with --rate."
        )


def _longest_even(recording: Recording) -> int:
    """Return the length of the longest stretch at an even rate, in rows; it may have short holes."""
    rows = Evidence.of(np.zeros(len(recording)), recording.timebase.elapsed_steps)
    return max(len(rows.z[part]) for part in (nearly_complete(rows), *rows.even))


def tuned_as_filter(causal: bool, lag_s: float | None, step_s: float) -> bool:
    """Return whether to tune as for a causal filter, by the likelihood of the next reading, and not as for a smoother.

    Parameters
    ----------
    causal : bool
        Whether estimates use no later readings.
    lag_s : float or None
        How long each estimate waits for later readings, in seconds; None without a lag.
    step_s : float
        One step, in seconds.

    Raises
    ------
    UsageError
        If a causal filter is given a lag, or the lag is shorter than one step or too long.
    """
    if lag_s is None:
        return causal
    refuse_causal_lag(causal, lag_s)
    return lag_in_rows(lag_s, step_s) <= SOON


def refuse_causal_lag(causal: bool | None, lag_s: float | None) -> None:
    """Raise a UsageError if a causal filter is given a lag, or `causal` is neither True nor False."""
    if not (causal is None or isinstance(causal, bool | np.bool_)):
        raise UsageError(f"causal = {causal!r:.60} came; give causal=True, or causal=False for a smoother.")
    if causal and lag_s is not None:
        raise UsageError("A causal filter uses no later reading; give a lag, or choose a causal filter, not both.")


def refuse_empty(recording: Recording) -> None:
    """Raise a RecordingError if the argument is not a Recording, or has no channels or samples."""
    if not isinstance(recording, Recording):
        raise RecordingError(
            f"A Recording is needed; {type(recording).__name__} came. Make one: becalm.Recording(samples, rate_hz=...)."
        )
    if not recording.names:
        raise RecordingError("No channel is left to clean; name at least one.")
    if not len(recording):
        raise RecordingError("The recording has no samples.")


def as_list(channels: Sequence[str]) -> list[str]:
    """Return names as a list; a str is a single name."""
    try:
        return [channels] if isinstance(channels, str) else list(channels)
    except TypeError as cause:
        raise RecordingError(f"channels = {channels!r:.60} is no list of names; give one, as in ['ax'].") from cause


def _ignore_progress(_: str) -> None:
    """Do nothing, as a default for `progress`."""


# Add the calibration uncertainty and the tare of a sensor to the recipes of its channels.


def calibrated(channels: Sequence[ChannelRecipe], calibrations: Mapping[str, Calibration]) -> tuple[ChannelRecipe, ...]:
    """Return the recipes with the calibrations of their sensors; `calibrations` has channel names as keys."""
    return tuple(_calibrated(channel, calibrations.get(channel.name)) for channel in channels)


def with_new_tares(
    channels: Sequence[ChannelRecipe], calibrations: Mapping[str, Calibration]
) -> tuple[ChannelRecipe, ...]:
    """Return the recipes with the calibrations of those sensors whose zero was measured in this recording."""
    tares = {name: one for name, one in calibrations.items() if one.tare is not None}
    return calibrated(channels, tares)


def _calibrated(channel: ChannelRecipe, found: Calibration | None) -> ChannelRecipe:
    if found is None or not (found.relative_std or found.offset_std or found.tare):
        return channel
    tare = None if found.tare is None else TareRecipe(**found.tare._asdict())
    calibration = CalibrationRecipe(relative_std=found.relative_std, offset_std=found.offset_std, tare=tare)
    return channel.model_copy(update={"calibration": calibration})
