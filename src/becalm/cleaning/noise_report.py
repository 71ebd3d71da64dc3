"""Measure the noise of a recording at rest: R, the noise above and below a cut-off, and the Allan deviation.

A rest is a stretch of time in which the sensor does not move.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from becalm.cleaning.allan_figures import AllanNoise, allan_noise
from becalm.cleaning.channels.faults import FALSE_ALARMS_PER_HOUR
from becalm.core.arrays import Floats
from becalm.core.health.limits import find_limits
from becalm.core.health.outlier_rule import is_outlier
from becalm.core.recording import Recording
from becalm.core.time.timebase import GAP_STEPS
from becalm.errors import RecordingError, UsageError
from becalm.identification.at_rest.allan import allan_deviation
from becalm.identification.at_rest.allan_terms import noise_terms
from becalm.identification.at_rest.detection import Stretch, detect_rests, quantum, rests_in_spans, runs_of
from becalm.identification.at_rest.rest_noise import RestNoise, noise_at_rest, split_at_cutoff

MOST_SLOW = 1.5
"""Largest ratio of the variance within half a second to R; with a larger one the report calls the noise slow."""

MOST_REPEATED = 0.4
"""Largest share of readings that equal the previous one; with a larger share the sensor is slower than its rows."""

MOST_MISFIT = 2.0
"""Largest misfit (1 is expected) for which the three terms describe the Allan deviation."""

_JITTER = 4.0  # standard deviations of the jitter that a step may be longer than `GAP_STEPS` without counting as a gap


@dataclass(frozen=True)
class ChannelNoise:
    """The noise of one channel at rest; None where a figure is unknown.

    Attributes
    ----------
    name, unit : str
        As in the recording.
    rest : str
        A sentence on where the rests are, or why there is none.
    stretches_s : tuple of (float, float)
        Start and end of each rest, in seconds after the first sample.
    noise_std, noise_std_error : float or None
        Square root of R, from differences of successive readings, and its standard error for white noise, in unit.
    slowness : float or None
        Variance within half a second, divided by R; see `becalm.identification.at_rest.rest_noise.RestNoise`.
    spikes : int
        Number of jumps of more than six standard deviations; `noise_std` leaves them out.
    cutoff_hz : float
        Frequency that separates `above_std` from `below_std`.
    above_std, below_std : float or None
        Standard deviation of the readings above and below the cut-off, in unit, in the longest part of a rest without a
        missing reading.
    allan : AllanNoise or None
        Figures of the Allan deviation over the longest rest.
    says : tuple of str
        Sentences on figures that are unknown or doubtful.
    """

    name: str
    unit: str
    rest: str
    stretches_s: tuple[tuple[float, float], ...]
    cutoff_hz: float
    noise_std: float | None = None
    noise_std_error: float | None = None
    slowness: float | None = None
    spikes: int = 0
    above_std: float | None = None
    below_std: float | None = None
    allan: AllanNoise | None = None
    says: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """Return the figures for JSON; unknown ones are None."""
        return asdict(self)


def report_noise(
    recording: Recording,
    *,
    still: Iterable[tuple[float, float]] | None = None,
    cutoff_hz: float = 1.0,
    progress: Callable[[str], object] = lambda name: None,
) -> tuple[ChannelNoise, ...]:
    """Measure the noise of each channel where all channels of a recording are at rest.

    Parameters
    ----------
    recording : Recording
        Channels that are at rest at the same time, such as those of one sensor; NaN where missing.
    still : iterable of (float, float), optional
        Start and end of each rest, in seconds after the first sample; by default the rests are detected.
    cutoff_hz : float
        Cut-off, in Hz: noise above it counts as measurement noise, noise below it as variation of the signal. With a
        *small* cut-off more of the noise counts as measurement noise.
    progress : callable, optional
        Called with the name of each channel when it is done.

    Returns
    -------
    tuple of ChannelNoise
        One element for each channel; without figures if there is no rest.

    Raises
    ------
    RecordingError
        If `still` is empty, or one of its rests is reversed, starts before the recording or has fewer than 32 samples.
    UsageError
        If the cut-off is not positive.

    Notes
    -----
    Noise at rest is a lower bound, because it does not contain the vibration of a sensor in use.
    """
    if not 0 < cutoff_hz < np.inf:
        raise UsageError(f"cutoff_hz = {cutoff_hz} is not a cut-off; give a positive number of hertz, such as 1.0.")
    whole, recording = recording, _without_outliers(recording)
    left_out = (np.isfinite(whole.samples) & ~np.isfinite(recording.samples)).sum(axis=0)
    stillness = detect_rests(recording) if still is None else rests_in_spans(recording, still)
    spans_s = tuple(_span_s(recording, stretch) for stretch in stillness.stretches)
    reports = []
    for name, unit, count in zip(recording.names, recording.units, left_out.tolist(), strict=True):
        says = (f"No figure includes markers of missing readings and gross outliers; readings left out: {count}.",)
        channel = ChannelNoise(name, unit, stillness.reason, spans_s, cutoff_hz, says=says if count else ())
        reports.append(_measured(channel, recording.select([name]), stillness.stretches) if spans_s else channel)
        progress(name)
    return tuple(reports)


def _measured(channel: ChannelNoise, recording: Recording, stretches: Sequence[Stretch]) -> ChannelNoise:
    """Return the channel with its figures over the rests; `recording` has only this channel."""
    (noise,) = noise_at_rest(recording, stretches)
    parts = [_with_gaps(recording, rest) for rest in stretches]
    step = quantum(recording.samples[:, 0])
    if reason := _why_hidden(noise, step, _repeated_share(parts)):
        return replace(channel, spikes=noise.spikes, says=(*channel.says, reason))
    above, below, no_split = _split(parts, recording.rate_hz, channel.cutoff_hz)
    allan, no_allan = _allan(recording, max(stretches, key=lambda rest: rest.stop - rest.start))
    std = float(np.sqrt(noise.variance))
    return replace(
        channel,
        noise_std=std,
        noise_std_error=noise.standard_error / (2 * std),
        slowness=noise.slowness if np.isfinite(noise.slowness) else None,
        spikes=noise.spikes,
        above_std=above,
        below_std=below,
        allan=allan,
        says=(*channel.says, *_doubts(noise, step), *no_split, *no_allan),
    )


def _repeated_share(parts: Sequence[Floats]) -> float:
    """Return the share of readings that equal the reading in the previous row, if that row has one."""
    steps = np.concatenate([np.diff(part) for part in parts])
    return float(np.mean(steps[np.isfinite(steps)] == 0)) if np.isfinite(steps).any() else 0.0


def _why_hidden(noise: RestNoise, step: float, repeated: float) -> str:
    """Return a sentence on why the readings do not show the noise, or "" if they do; `step` as in `_doubts`."""
    if not np.isfinite(noise.variance):
        return f"At rest {noise.differences} readings follow another without a gap; 32 are needed to measure the noise."
    if not noise.variance > 0:
        return "Every reading at rest is the same: the noise is below the resolution of the sensor."
    if repeated > MOST_REPEATED and noise.variance > (2 * step) ** 2:
        return (
            f"At rest {repeated:.0%} of the readings repeat the previous one: the sensor is slower than the rows."
            " Give a record with one row for each reading to measure its noise."
        )
    return ""


def _doubts(noise: RestNoise, step: float) -> list[str]:
    """Return sentences on why R is doubtful; `step` is the smallest difference between two readings, in unit."""
    says = []
    if np.sqrt(noise.variance) < step / 2:
        says.append(f"The readings have a resolution of {step:.3g}, more than twice the noise: R is that of rounding.")
    if noise.slowness > MOST_SLOW:
        says.append(
            f"The noise is slower than the readings: over half a second its variance is {noise.slowness:.3g} times R, "
            f"which is only that of its fastest part."
        )
    if noise.spikes:
        jumps = "1 jump is" if noise.spikes == 1 else f"{noise.spikes} jumps are"
        says.append(f"{jumps} beyond six standard deviations; R does not include them, all other figures do.")
    return says


def _split(parts: Sequence[Floats], rate_hz: float, cutoff_hz: float) -> tuple[float | None, float | None, list[str]]:
    """Return the standard deviations above and below the cut-off, and sentences on why they are unknown."""
    if cutoff_hz >= rate_hz / 2:
        return None, None, [f"A rate of {rate_hz:.4g} Hz does not show the noise above {cutoff_hz:g} Hz."]
    longest = max(map(_longest_complete, parts), key=len)
    try:
        noise, process = split_at_cutoff(longest, rate_hz, cutoff_hz)
    except RecordingError as cause:
        return None, None, [str(cause)]
    return float(np.sqrt(noise)), float(np.sqrt(process)), []


def _allan(recording: Recording, rest: Stretch) -> tuple[AllanNoise | None, list[str]]:
    """Return the figures of the Allan deviation over one rest, and sentences on unknown or doubtful figures."""
    try:
        terms = noise_terms(allan_deviation(_with_gaps(recording, rest), recording.rate_hz))
    except RecordingError as cause:
        return None, [str(cause)]
    found = allan_noise(terms, recording.units[0], _span_s(recording, rest), recording.rate_hz)
    says = [term.reason for term in (found.white_noise, found.bias_instability, found.random_walk) if term.reason]
    if found.misfit > MOST_MISFIT:
        says.append(
            f"White noise, bias instability and random walk do not describe the Allan deviation (misfit "
            f"{found.misfit:.2g}; 1 is expected): vibration, temperature or a filter within the sensor shapes it."
        )
    return found, says


def _with_gaps(recording: Recording, rest: Stretch) -> Floats:
    """Return the readings of one channel over a rest, in unit, with one NaN inserted for each gap between rows.

    One NaN for a gap of any length is enough to leave out differences across the gap. Jitter does not count as a gap.
    """
    readings, time = recording.samples[slice(*rest), 0], recording.timebase
    jitter_steps = 0.0 if time.uniform else time.jitter_s / time.step_s
    gaps = 1 + np.flatnonzero(time.elapsed_steps[slice(*rest)][1:] > GAP_STEPS + _JITTER * jitter_steps)
    return np.insert(readings, gaps, np.nan)


def _longest_complete(readings: Floats) -> Floats:
    """Return the longest run of readings without a missing reading."""
    runs = runs_of(np.isfinite(readings))
    first, last = max(runs, key=lambda run: run[1] - run[0], default=(0, -1))
    return readings[first : last + 1]


def _span_s(recording: Recording, rest: Stretch) -> tuple[float, float]:
    """Return the start and the end of a rest, in seconds after the first sample."""
    times_s = recording.times_s
    return float(times_s[rest.start] - times_s[0]), float(
        times_s[rest.stop - 1] - times_s[0] + recording.timebase.step_s
    )


def _without_outliers(recording: Recording) -> Recording:
    """Return the recording with NaN in place of impossible readings, markers of missing readings and gross outliers.

    Cleaning leaves out the same readings.
    """
    elapsed, step_s = recording.timebase.elapsed_steps, recording.timebase.step_s
    columns = []
    for z in recording.samples.T:
        limits = find_limits(z, elapsed, FALSE_ALARMS_PER_HOUR, step_s)
        possible = np.where(np.abs(z) <= limits.largest, z, np.nan)
        columns.append(np.where(is_outlier(possible, limits.outliers), np.nan, possible))
    return recording.with_samples(np.column_stack(columns)) if columns else recording
