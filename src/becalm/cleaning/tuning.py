"""tune(recording) -> Recipe: the noise of each channel identified, its filter chosen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np

from becalm.cleaning.alarms import with_alarms
from becalm.cleaning.faults import find_healthy
from becalm.cleaning.hidden_blocks import holes_shown
from becalm.cleaning.limits_entry import with_rounding
from becalm.cleaning.modes import modes_in_seconds
from becalm.cleaning.recipe import ChannelRecipe, Mode, Origin, Recipe
from becalm.cleaning.recipe_parts import GateRecipe
from becalm.cleaning.steps import SOON, gate_of, in_seconds, lag_in_rows
from becalm.cleaning.timing import time_std_of, timed
from becalm.core.recording import Recording
from becalm.core.verdict import judge
from becalm.errors import RecordingError, UsageError
from becalm.identification.choose import Choice, PriorKnowledge
from becalm.identification.coloured import NoiseModel, fit_noise
from becalm.identification.damping import spread_std
from becalm.identification.gating import choose_gated, forecasts
from becalm.identification.imputation import nearly_complete
from becalm.identification.likelihood import FEWEST_FOR_TONES, Evidence, Tuning
from becalm.identification.lines import MOST_TONES
from becalm.identification.modes.robust import choose_robust
from becalm.identification.modes.switching import Switched, find_switching
from becalm.identification.rest.detection import said_still
from becalm.identification.trust.tuning_spread import tuning_spread
from becalm.identification.wishes.dial import Dial, may_judge, turn
from becalm.installation import load_scipy, version

_NEARLY_EMPTY = 64  # readings, below which a channel need not tell its noise at rest

Progress = Callable[[str], None]


class Wishes(NamedTuple):
    """What a person asks or knows; everything else the recording tells.

    Attributes
    ----------
    dial : Dial or None
        A lag, a bandwidth or a noise gain that every filter shall have.
    still_s : tuple of (float, float)
        Where the sensor lay still, from and to in seconds after the first row: the noise is told there.
    rest : Recording or None
        The recording that those seconds count in, where it is another one, of the same channels.
    removed_hz : tuple of float
        Frequencies of tones to take off, as of mains hum.
    lag_s : float or None
        How long each estimate may wait for later readings; with a *small* one it comes soon, and noisier.
    robust : bool
        Whether many readings are wild, one in a hundred to one in ten, and shall be left out.
    fill : bool
        Whether the best guess is told in holes of which the model knows nothing, too.
    time_std_s : float or None
        Standard uncertainty (k = 1) of the time of each reading, independent of the others: jitter of the sampling
        clock, in seconds. None takes it from the last digit of stamps that are no even grid.
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
    """What was found for one channel."""

    channel: ChannelRecipe  # what was decided
    choice: Choice  # what it was chosen among
    believed: Evidence  # the readings that told it


class Tuned(NamedTuple):
    """A recipe, and what was found for each of its channels on the way."""

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
    """Identify the noise of each channel and choose its filter; nothing needs to be asked.

    Parameters
    ----------
    recording : Recording
        Samples (N, m), NaN where missing.
    causal : bool
        Whether the recipe shall filter (True) or smooth.
    channels : sequence of str, optional
        Names of the channels to clean; all by default.
    wishes : Wishes
        A dial, where the sensor lay still, tones to take off; by default the recording decides.
    progress : callable, optional
        Called with a channel's name when it is done.

    Raises
    ------
    RecordingError
        If a channel does not exist, or there are no channels or samples, or too few where the sensor is
        said to be still.
    UsageError
        If no filter has what the dial asks, or wishes do not go together.
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
    """Do as `tune`, and tell what each filter was chosen among, too."""
    refuse_empty(recording)
    chosen = recording if channels is None else recording.select(listed(channels))
    refuse_empty(chosen)
    if not isinstance(wishes, Wishes):
        raise UsageError(f"Wishes are needed; {wishes!r:.60} came. Make some: becalm.Wishes(lag_s=0.01).")
    _refuse_contradictions(wishes, chosen)
    as_filter = tuned_as_filter(causal, wishes.lag_s, chosen.timebase.step_s)
    one = partial(_tune_channel, chosen, as_filter, wishes, progress or _silent)
    load_scipy()
    pool = ThreadPoolExecutor()
    try:
        found = tuple(pool.map(one, chosen.names))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)  # who stops it need not wait for the others
    origin = Origin(rows=len(chosen), rate_hz=chosen.rate_hz, becalm=version())
    mode: Mode = "causal" if causal else "smoothed" if wishes.lag_s is None else "lagged"
    recipe = Recipe(mode=mode, lag_s=wishes.lag_s, tuned_on=origin, channel=tuple(one.channel for one in found))
    std_s = time_std_of(chosen.timebase) if wishes.time_std_s is None else wishes.time_std_s
    return Tuned(timed(recipe, chosen, std_s, at_rest=bool(wishes.still_s)) if std_s else recipe, found)


def _tune_channel(recording: Recording, causal: bool, wishes: Wishes, progress: Progress, name: str) -> ChannelTuning:
    found = _found(recording, causal, wishes, name)
    if not causal and wishes.lag_s is None and found.channel.motion is not None:
        hole = holes_shown(found.channel, found.believed, recording.timebase.step_s)
        found = found._replace(channel=found.channel.model_copy(update={"hole": hole}))
    progress(name)
    return found


def _found(recording: Recording, causal: bool, wishes: Wishes, name: str) -> ChannelTuning:
    time, unit = recording.timebase, recording.units[recording.names.index(name)]
    known = PriorKnowledge(
        _rest_noise(wishes.rest or recording, name, wishes.still_s) if wishes.still_s else None,
        tuple(2 * np.pi * frequency * time.step_s for frequency in wishes.removed_hz),
    )
    told, elapsed = GateRecipe(), time.elapsed_steps
    gate = gate_of(told, time.step_s)
    readings, outliers, limits = find_healthy(recording.channel(name), elapsed, time.step_s, causal=causal)
    choice, gated = choose_gated(readings, elapsed, gate, causal, known)
    evidence = Evidence.of(readings, elapsed)
    if choice.tuning is None or choice.motion is None:
        return ChannelTuning(ChannelRecipe(name=name, unit=unit, model=choice.kind, limits=limits), choice, evidence)
    found, spread = choice.tuning, 0.0
    if wishes.dial is not None:
        found = turn(choice.motion, wishes.dial, time.step_s, causal)
        gated = gated and may_judge(found, choice.tuning)
    unknown = {"spread_std": spread_std(evidence), "fill": wishes.fill}
    limits = with_rounding(limits, found, readings, causal=causal)
    foretold = forecasts(found, readings, elapsed, gate if gated else None)
    if wishes.dial is None:  # what a person asked for is no estimate: it has no spread, and nothing replaces it
        if not wishes.still_s and not wishes.removed_hz:
            spikes = None if wishes.robust else bool(foretold.rejected.any())
            all_readings = Evidence.of(np.where(np.isfinite(outliers), outliers, readings), elapsed)
            own = evidence.own_step
            seen, every = evidence.counted_in(own), all_readings.counted_in(own)
            switched = _switched(found.counted_in(own), seen, causal, spikes, every)
            if switched is not None:
                modes = modes_in_seconds(switched.kind, switched.switching, own * time.step_s)
                switching = in_seconds(name, unit, switched.tuning.counted_in(1 / own), time.step_s)
                more = {"switching": modes, "limits": limits, **unknown}
                return ChannelTuning(switching.model_copy(update=more), choice, evidence)
        evidence = Evidence.of(np.where(foretold.rejected, np.nan, readings), elapsed) if gated else evidence
        own = 1.0 if found.coloured else evidence.own_step
        steps = found.counted_in(own), evidence.counted_in(own)
        spread = tuning_spread(*steps, causal, noise_known=known.noise is not None)
    limits = with_alarms(limits, found, foretold.normalised, causal=causal, step_s=time.step_s)
    own_hz = 1 / (evidence.own_step * time.step_s) if evidence.own_step > 1 and not found.coloured else None
    beside = {"gate": told if gated else None, "limits": limits, "rate_hz": own_hz, **unknown}
    return ChannelTuning(in_seconds(name, unit, found, time.step_s, spread).model_copy(update=beside), choice, evidence)


def _switched(tuning: Tuning, evidence: Evidence, causal: bool, spikes: bool | None, wild: Evidence) -> Switched | None:
    """Find modes for a channel; `spikes` tells whether a gate leaves some out, None that many are to be left out."""
    if spikes is None:
        return choose_robust(tuning, evidence, causal)
    return find_switching(tuning, evidence, causal, spikes, wild)


def _rest_noise(rest: Recording, name: str, still_s: Sequence[tuple[float, float]]) -> NoiseModel | None:
    """Tell a channel's noise where it lay still; in uneven time all of it counts as white. None where there is none."""
    readings, elapsed = judge(rest.channel(name)).readings, rest.timebase.elapsed_steps
    parts = [slice(*stretch) for stretch in said_still(rest, still_s).stretches]
    if not any(np.nanstd(readings[part]) > 0 for part in parts if np.isfinite(readings[part]).any()):
        return None
    try:
        found = fit_noise([readings[part] for part in parts])
    except RecordingError as cause:
        if np.isfinite(readings).sum() < _NEARLY_EMPTY:
            return None  # as of any other recording
        raise RecordingError(f"{name}: {cause}") from cause
    even = all(np.array_equal(elapsed[part][1:], np.round(elapsed[part][1:])) for part in parts)
    if even or found.coloured is None:
        return found
    return NoiseModel(found.white_variance + found.coloured.variance, None, found.drift_density, found.count)


def _refuse_contradictions(wishes: Wishes, recording: Recording) -> None:
    removed, rate_hz = wishes.removed_hz, recording.rate_hz
    if wishes.robust and (wishes.dial is not None or wishes.still_s or removed):
        raise UsageError("A robust filter finds its own noise and has no dial or tones; ask for one thing at a time.")
    if removed and (wishes.dial is not None or wishes.still_s):
        raise UsageError("Tones are taken off only where the recording decides the rest; ask for one at a time.")
    if len(removed) > MOST_TONES:
        raise UsageError(f"{len(removed)} tones to take off are too many; name up to {MOST_TONES}.")
    if removed and not all(0 < frequency < rate_hz / 2 for frequency in removed):
        raise UsageError(
            f"Tones to take off lie between 0 and {rate_hz / 2:.6g} Hz, half of the rate;"
            f" {', '.join(f'{frequency:.6g}' for frequency in removed)} Hz came."
        )
    if removed and _longest_even(recording) < FEWEST_FOR_TONES:
        raise UsageError(
            f"To take off tones, {FEWEST_FOR_TONES} rows in even time without a gap are needed;"
            f" {'no stretch is so even' if len(recording) >= FEWEST_FOR_TONES else f'{len(recording)} rows came'}."
            " Give a longer recording, or with --rate the rate at which the rows were taken."
        )


def _longest_even(recording: Recording) -> int:
    """Return how many rows come in even time, but for short holes, at the most."""
    rows = Evidence.of(np.zeros(len(recording)), recording.timebase.elapsed_steps)
    return max(len(rows.z[part]) for part in (nearly_complete(rows), *rows.even))


def tuned_as_filter(causal: bool, lag_s: float | None, step_s: float) -> bool:
    """Whether the likelihood of the next reading tunes, as of a causal filter, or what a smoother is tuned by.

    Parameters
    ----------
    causal : bool
        Whether estimates know only the past.
    lag_s : float or None
        How long each waits for later readings, in seconds; None where it is not said.
    step_s : float
        One step, in seconds.

    Raises
    ------
    UsageError
        If a lag is asked of a causal filter, or no later reading comes within it.
    """
    if lag_s is None:
        return causal
    refuse_causal_lag(causal, lag_s)
    return lag_in_rows(lag_s, step_s) <= SOON


def refuse_causal_lag(causal: bool | None, lag_s: float | None) -> None:
    """Raise a UsageError where a lag is asked of a causal filter."""
    if causal and lag_s is not None:
        raise UsageError("A causal filter waits for no later reading; ask for a lag, or for a causal filter.")


def refuse_empty(recording: Recording) -> None:
    """Raise a RecordingError where there is nothing to clean."""
    if not isinstance(recording, Recording):
        raise RecordingError(
            f"A Recording is needed; {type(recording).__name__} came. Make one: becalm.Recording(samples, rate_hz=...)."
        )
    if not recording.names:
        raise RecordingError("No channel is left to clean; name at least one.")
    if not len(recording):
        raise RecordingError("The recording has no samples.")


def listed(channels: Sequence[str]) -> list[str]:
    """Return names as a list; one alone may come as it is."""
    return [channels] if isinstance(channels, str) else list(channels)


def _silent(_: str) -> None:
    """Say nothing."""
