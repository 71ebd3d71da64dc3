"""Compare becalm with classic filters on the same recording: at equal noise, at equal lag, and tuned with the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from becalm.classic.matching import best_with_truth, equal_lag, equal_noise, lag, noise_gain, overshoot
from becalm.classic.register import CAUSAL, ZERO_PHASE, Classic
from becalm.cleaning.channels.figures import response_of
from becalm.cleaning.pipeline import Cleaned, clean, in_mode
from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import NOT_READ, Verdict, judge
from becalm.core.recording import Recording
from becalm.core.steady.response import Response, decibels
from becalm.errors import RecordingError, UsageError
from becalm.metrics.delay import lag_of
from becalm.metrics.truth import rms_error

BECALM = "becalm"
RULES = ("equal noise", "equal lag", "best with truth")

_MOST_TRUTH_ROWS = 50_000  # largest number of rows on which the best setting with a truth is searched
_SAME_DB = 1.0  # dB: largest difference of noise that counts as equal; an average can only have a whole length


class Contender(NamedTuple):
    """One filter on one channel, and its results.

    Attributes
    ----------
    name : str
        "becalm", or the name of a classic filter.
    rule : str
        Rule for its setting: "" for becalm, or one of `RULES`.
    cutoff_hz : float or None
        Setting of a classic filter.
    noise_removed_db : float or None
        Reduction of white noise: 10 log10(variance before / variance after). None for a filter that adapts or has no
        steady state. For a filter with several modes, `noise_removed_db`, `lag_s` and `overshoot_percent` are those of
        the most probable mode.
    lag_s : float or None
        Delay of a slow signal, or of a step at half height, whichever is longer.
    overshoot_percent : float or None
        Overshoot after a step, in percent of the height of the step.
    rms_error : float or None
        Root mean square difference from the truth, in unit; None without a truth.
    measured_lag_s : float or None
        Delay of the output behind the truth, see `becalm.metrics.delay.lag_of`; None if undetermined.
    """

    name: str
    rule: str = ""
    cutoff_hz: float | None = None
    noise_removed_db: float | None = None
    lag_s: float | None = None
    overshoot_percent: float | None = None
    rms_error: float | None = None
    measured_lag_s: float | None = None


class ChannelComparison(NamedTuple):
    """The results of all filters on one channel; becalm is the first of `contenders`."""

    name: str
    unit: str
    contenders: tuple[Contender, ...]  # only becalm if the channel passes unchanged
    says: str  # the text of becalm's judgement of its own model


class Comparison(NamedTuple):
    """The results of all filters on all channels."""

    causal: bool
    channels: tuple[ChannelComparison, ...]
    cleaned: Cleaned


class _Readings(NamedTuple):
    """The readings of one channel, and its true signal if it is known."""

    z: Floats
    truth: Floats | None
    step_s: float


def compare(
    recording: Recording,
    recipe: Recipe | None = None,
    *,
    truth: Recording | None = None,
    causal: bool | None = None,
    channels: Sequence[str] | None = None,
) -> Comparison:
    """Clean a recording with becalm and with every classic filter.

    Parameters
    ----------
    recording : Recording
        Samples (N, m), NaN where missing. Classic filters ignore the times and assume an even rate. Readings that
        cleaning takes for no readings, such as markers, stuck and clipped ones, count as missing for all filters.
    recipe : Recipe, optional
        As in `clean`.
    truth : Recording, optional
        True signal with N rows: channels of the same names and units, at the same times since the first row; not finite
        where it is unknown. With a truth, each classic filter also gets the setting with the least rms error over up
        to 50 000 rows, from the first row with a known truth on.
    causal : bool, optional
        As in `clean`: a causal filter is compared with causal filters, a smoother with zero-phase filters.
    channels : sequence of str, optional
        Names of the channels to compare; all by default.

    Raises
    ------
    UsageError
        If the recipe has a lag, because no classic filter waits for one.
    RecordingError
        If the truth has another number of rows, other times or units, or lacks a channel; also as in `clean`.
    RecipeError
        As in `clean`.
    """
    if recipe is not None and in_mode(recipe, causal).mode == "lagged":
        raise UsageError("No classic filter waits for a lag; compare a causal filter (--causal) or a smoother.")
    cleaned = clean(recording, recipe, causal=causal, channels=channels)
    true = None if truth is None else _true_channels(truth, recording, cleaned)
    is_causal, step_s = cleaned.recipe.mode == "causal", recording.timebase.step_s
    comparisons = []
    for place, (channel, report) in enumerate(zip(cleaned.recipe.channel, cleaned.reports, strict=True)):
        verdicts, possible = cleaned.verdicts[channel.name], judge(recording.channel(channel.name)).readings
        z = np.where(NOT_READ[verdicts] | (verdicts == Verdict.HOLE), np.nan, possible)
        readings = _Readings(z, None if true is None else true[:, place], step_s)
        response = response_of(channel, report, step_s, is_causal)
        contenders = (
            _becalm(cleaned.signal.samples[:, place], readings, response),
            *(() if response is None else _classics(readings, response, is_causal)),
        )
        comparisons.append(ChannelComparison(channel.name, channel.unit, contenders, report.says))
    return Comparison(is_causal, tuple(comparisons), cleaned)


def _true_channels(truth: Recording, recording: Recording, cleaned: Cleaned) -> Floats:
    """Return the true signals (N, m) in the order of the cleaned channels."""
    names = [channel.name for channel in cleaned.recipe.channel]
    missing = [name for name in names if name not in truth.names]
    if missing:
        raise RecordingError(
            f"The truth has no channel {missing[0]!r}; it has {', '.join(map(repr, truth.names))}."
            " Give the channels that it has with --channels."
        )
    if len(truth.samples) != len(recording.samples):
        raise RecordingError(
            f"The truth has {len(truth.samples)} rows, the recording {len(recording.samples)}; give the truth of the"
            " same rows."
        )
    _refuse_other_times(truth, recording)
    _refuse_other_units(truth, cleaned)
    return np.column_stack([judge(np.ascontiguousarray(truth.channel(name))).readings for name in names])


def _refuse_other_times(truth: Recording, recording: Recording) -> None:
    """Raise a RecordingError if the times since the first row differ between truth and recording."""
    differences_s = np.abs(_since_first_s(truth) - _since_first_s(recording))
    if not differences_s.max() <= recording.timebase.step_s / 2:
        row = int(np.argmax(differences_s > recording.timebase.step_s / 2))
        raise RecordingError(
            f"Row {row + 1} of the truth is {_since_first_s(truth)[row]:.6g} s after its first row, but in the"
            f" recording {_since_first_s(recording)[row]:.6g} s; give the truth at the same times, or --rate for both."
        )


def _since_first_s(recording: Recording) -> Floats:
    """Return the time of each row, in seconds after the first row."""
    elapsed = recording.timebase.elapsed_steps
    return np.asarray(np.cumsum(np.append(0.0, elapsed[1:])) * recording.timebase.step_s)


def _refuse_other_units(truth: Recording, cleaned: Cleaned) -> None:
    units = dict(zip(truth.names, truth.units, strict=True))
    for channel in cleaned.recipe.channel:
        if units[channel.name] and channel.unit and units[channel.name] != channel.unit:
            raise RecordingError(
                f"The truth of {channel.name!r} is in {units[channel.name]}, the recording in {channel.unit}; give it"
                f" in {channel.unit}."
            )


def _becalm(signal: Floats, readings: _Readings, response: Response | None) -> Contender:
    contender = Contender(BECALM)
    if response is not None:
        contender = contender._replace(
            noise_removed_db=-response.noise_gain_db,
            lag_s=response.lag_s if np.isfinite(response.lag_s) else None,
            overshoot_percent=None if response.step is None else response.step.overshoot_percent,
        )
    return _with_errors(contender, signal, readings)


def _classics(readings: _Readings, response: Response, causal: bool) -> Iterator[Contender]:
    """Yield the results of each classic filter for each rule of `RULES` that a setting can meet.

    `response` is that of becalm's filter, whose noise and lag the classic filters must equal.
    """
    for classic in CAUSAL if causal else ZERO_PHASE:
        if classic.reduces_noise:
            contender = _classic(classic, readings, "equal noise", equal_noise(classic, response.noise_gain))
            if abs((contender.noise_removed_db or 0.0) + response.noise_gain_db) <= _SAME_DB:
                yield contender
        if classic.reduces_noise and causal and np.isfinite(response.lag_s) and response.lag_s > 0:
            contender = _classic(classic, readings, "equal lag", equal_lag(classic, response.lag_s / readings.step_s))
            if abs((contender.lag_s or 0.0) - response.lag_s) <= readings.step_s:
                yield contender
        if readings.truth is not None and np.isfinite(readings.truth).any():
            first = int(np.argmax(np.isfinite(readings.truth)))
            part = slice(first, first + _MOST_TRUTH_ROWS)
            best = best_with_truth(classic, readings.z[part], readings.truth[part])
            yield _classic(classic, readings, "best with truth", best)


def _classic(classic: Classic, readings: _Readings, rule: str, cutoff: float) -> Contender:
    contender = Contender(classic.name, rule, cutoff / readings.step_s)
    if classic.reduces_noise:
        contender = contender._replace(
            noise_removed_db=-decibels(noise_gain(classic, cutoff)),
            lag_s=lag(classic, cutoff) * readings.step_s,
            overshoot_percent=100 * overshoot(classic, cutoff),
        )
    if readings.truth is None:
        return contender
    return _with_errors(contender, classic.clean(readings.z, cutoff), readings)


def _with_errors(contender: Contender, signal: Floats, readings: _Readings) -> Contender:
    if readings.truth is None or not np.isfinite(signal - readings.truth).any():
        return contender
    lag_steps = lag_of(signal, readings.truth)
    return contender._replace(
        rms_error=rms_error(signal, readings.truth),
        measured_lag_s=lag_steps * readings.step_s if np.isfinite(lag_steps) else None,
    )
