"""Measure the noise of a sensor at rest: from differences of neighbours, or split at a cut-off as in the IMU paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.core.time.timebase import GAP_STEPS
from becalm.errors import RecordingError
from becalm.identification.at_rest.detection import FEWEST, Stretch, quantum, window_size

_SPIKE = 6.0  # distance, in standard deviations, beyond which a difference is left out as a spike
_KEPT = 0.9  # share of the differences that set the limit for spikes
_NORMAL_KEPT = 0.6230  # mean square of the nine tenths of a normal variable that are nearest to zero
_FEWEST_CYCLES = 10.0  # least number of cycles of the cut-off in the stretch
_SPLIT_ORDER = 2  # order of the Butterworth filters


@dataclass(frozen=True)
class RestNoise:
    """The noise of one channel at rest.

    Attributes
    ----------
    name : str
        Name of the channel.
    variance : float
        R, half of the mean squared difference of neighbours, in unit^2; NaN if there are under 32 differences.
    standard_error : float
        Standard error of `variance` if the noise is white, in unit^2.
    slowness : float
        Variance within half a second divided by `variance`. It is 1 for white noise. If it is above 1, the noise is
        slower than the readings, and `variance` is only that of its fastest part; if it is below 1, the noise
        alternates.
    differences, spikes : int
        Number of differences used, and number of differences left out because they exceed six standard deviations.
    """

    name: str
    variance: float
    standard_error: float
    slowness: float
    differences: int
    spikes: int


class Split(NamedTuple):
    """The variances of a motionless record above and below a cut-off, in unit^2.

    Attributes
    ----------
    noise_variance : float
        R, the variance above the cut-off.
    process_variance : float
        Q, the variance below the cut-off.
    """

    noise_variance: float
    process_variance: float


def noise_at_rest(recording: Recording, stretches: Sequence[Stretch]) -> tuple[RestNoise, ...]:
    """Measure the noise of each channel where it is at rest.

    Parameters
    ----------
    recording : Recording
        The record, with any channels.
    stretches : sequence of Stretch
        The rests, from `detect_rests` or `rests_in_spans`.

    Raises
    ------
    RecordingError
        If there is no stretch.

    Notes
    -----
    A drift of b units per step adds only b^2 / 2 to the variance. Squared differences of white noise are correlated
    with their neighbours only; hence the standard error, variance * sqrt(3 / N) for normal noise (von Neumann and
    others, Annals of Mathematical Statistics 12 (1941) 153).
    """
    if not stretches:
        raise RecordingError("There is no rest to measure noise in; name one, as 0:30 for the first half minute.")
    return tuple(_channel_noise(recording, name, stretches) for name in recording.names)


def split_at_cutoff(readings: Floats, rate_hz: float, cutoff_hz: float = 1.0) -> Split:
    """Split a motionless record into measurement noise above a cut-off and process noise below it.

    Parameters
    ----------
    readings : (N,) float array
        Readings of one stretch, in unit, none missing.
    rate_hz : float
        Readings per second.
    cutoff_hz : float
        The cut-off; a *small* one assigns more of the record to measurement noise.

    Raises
    ------
    RecordingError
        If a reading is missing, the stretch is shorter than ten cycles of the cut-off, or the cut-off is not below half
        of the rate.

    Notes
    -----
    Kownacki (2010), table 1, does not name the filter: here it is a causal Butterworth filter of order 2, started at
    the mean. A share of 2.22 cutoff / rate of white noise counts as process noise. As the paper notes, the variances
    give a far slower filter than a person wants: the motion at rest is not the motion in use.
    """
    from scipy.signal import butter, sosfilt

    if not np.isfinite(readings).all():
        raise RecordingError("A record with gaps cannot be split at a cut-off; give a stretch with no reading missing.")
    if not 0 < cutoff_hz < rate_hz / 2:
        raise RecordingError(
            f"cutoff_hz = {cutoff_hz:g} is not a cut-off at {rate_hz:g} Hz; stay below half of the rate."
        )
    if len(readings) * cutoff_hz < _FEWEST_CYCLES * rate_hz:
        raise RecordingError(
            f"{len(readings) / rate_hz:.3g} s are too short to be split at {cutoff_hz:g} Hz; "
            f"{_FEWEST_CYCLES / cutoff_hz:g} s are needed, or a higher cut-off."
        )
    centred = readings - readings.mean()
    above, below = (
        float(np.var(sosfilt(butter(_SPLIT_ORDER, cutoff_hz, kind, fs=rate_hz, output="sos"), centred)))
        for kind in ("highpass", "lowpass")
    )
    return Split(above, below)


def _channel_noise(recording: Recording, name: str, stretches: Sequence[Stretch]) -> RestNoise:
    channel, elapsed = recording.channel(name), recording.timebase.elapsed_steps
    steps = [_differences(channel[a:b], elapsed[a:b]) for a, b in stretches]
    square = np.concatenate([part**2 / 2 for step in steps for part in (step, np.array([np.nan]))])
    seen = np.isfinite(square)
    count = int(np.count_nonzero(seen))
    if count < FEWEST:
        return RestNoise(name, np.nan, np.nan, np.nan, count, 0)
    kept = np.sort(square[seen])[: int(np.ceil(_KEPT * count))]
    most = _SPIKE**2 * max(kept.mean() / _NORMAL_KEPT, quantum(channel) ** 2)
    square[square > most] = np.nan
    used = int(np.count_nonzero(np.isfinite(square)))
    variance = float(np.nanmean(square))
    slow = _variance_within([channel[a:b] for a, b in stretches], window_size(recording.rate_hz), most)
    slowness = slow / variance if variance > 0 else np.nan
    return RestNoise(name, variance, _standard_error(square, used), slowness, used, count - used)


def _differences(channel: Floats, elapsed: Floats) -> Floats:
    """Return the differences of neighbours (n - 1,); NaN across a gap or a missing reading."""
    return np.where(elapsed[1:] <= GAP_STEPS, np.diff(channel), np.nan)


def _standard_error(square: Floats, used: int) -> float:
    """Return the standard error of the mean of a sequence in which only neighbours are correlated; NaN is left out."""
    about = square - np.nanmean(square)
    power, neighbours = float(np.nansum(about**2)), float(np.nansum(about[1:] * about[:-1]))
    return float(np.sqrt(max(0.0, power + 2 * neighbours)) / used)


def _variance_within(stretches: Sequence[Floats], size: int, most: float) -> float:
    """Return the mean variance, in unit^2, of the windows of `size` readings without a spike, about their own means.

    A spike is where half of the squared difference of neighbours exceeds `most`.
    """
    windows = np.concatenate([part[: len(part) // size * size].reshape(-1, size) for part in stretches])
    whole = windows[(np.diff(windows, axis=1) ** 2 / 2 <= most).all(axis=1)]
    return float(np.var(whole, axis=1, ddof=1).mean()) if len(whole) else np.nan
