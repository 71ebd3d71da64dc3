"""Find where a sensor is at rest, or use the rests that a person names.

The readings of a sensor at rest are only noise, which two properties identify without units or a datasheet: its power
is constant, and its past does not predict it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Booleans, Floats
from becalm.core.recording import Recording
from becalm.core.time.timebase import GAP_STEPS
from becalm.errors import RecordingError
from becalm.metrics.whiteness import whiteness

# Cut a record into windows, and test which windows hold only noise.
#
# The quietest run of windows sets a noise floor for each channel; windows whose power is at this floor are calm.

Value = TypeVar("Value", bound=np.generic)

FEWEST = 32
"""Least number of readings in a window."""

MOST_MISSING = 0.25
"""Largest share of readings that may be missing in a window, or in a channel that is used to find rests."""

_NORMAL_MAD = 1.4826  # standard deviation over median absolute deviation
_WINDOW_S = 0.5  # length of a window, in seconds
_BLOCKS = 8  # in a window
_KEPT = 0.9  # share of a window's readings, nearest to its median, that set its power; the others may be spikes
_SPIKE = 4.0  # distance from a window's median, in standard deviations, to which readings are clipped
_SIGMAS = 3.5  # standard deviations by which the log power of a calm window may exceed the floor by chance
_WARMTH = 0.25  # change of the log power while a sensor warms up
_ROUNDS = 8  # most iterations of the floor
_DRIFT = 8 * _BLOCKS  # length, in blocks, of the pieces from which a straight line is subtracted as drift


class Windows(NamedTuple):
    """W windows of a record of m channels; two adjacent windows overlap by half.

    Attributes
    ----------
    hop : int
        Readings from one window to the next, half of a window.
    log_power : (W, m) float array
        Logarithm of the mean square about the median, in unit^2, of the nine tenths of readings nearest to the median.
    chance : (W, m) float array
        Standard deviation of `log_power` due to chance, estimated from the powers of the window's eight blocks.
    means : (W, 8, m) float array
        Means of the blocks, in unit.
    sound : (W,) bool array
        True where a window has enough readings, no long gap, and no slope that exceeds the noise.
    """

    hop: int
    log_power: Floats
    chance: Floats
    means: Floats
    sound: Booleans

    @classmethod
    def of(cls, recording: Recording) -> Windows | None:
        """Cut a record into windows of half a second, at least 32 readings; None if it is shorter than one."""
        samples, hop = recording.samples, window_size(recording.rate_hz) // 2
        if len(samples) < 2 * hop:
            return None
        measured = [_measure(channel, hop) for channel in samples.T]
        log_power, chance, means = (np.stack(part, axis=-1) for part in zip(*measured, strict=True))
        missing = _cut(~np.isfinite(samples), hop).mean(axis=-1).max(axis=1)
        longest = _cut(recording.timebase.elapsed_steps, hop)[:, 1:].max(axis=1)
        sound = (missing <= MOST_MISSING) & (longest <= max(GAP_STEPS, MOST_MISSING * 2 * hop))
        sound &= (_slope_power(means) <= np.exp(log_power)).all(axis=1)
        return cls(hop, log_power, chance, means, sound)

    def calm(self, count: int) -> Booleans:
        """Return which windows (W,) are as quiet, in all channels, as the quietest `count` windows in a row."""
        loudness = np.where(self.sound, self.log_power.mean(axis=1), np.inf)
        row = int(np.lib.stride_tricks.sliding_window_view(loudness, count).max(axis=1).argmin())
        calm = np.zeros(len(loudness), dtype=bool)
        calm[row : row + count] = self.sound[row : row + count]
        for _ in range(_ROUNDS):
            if not calm.any():
                break
            floor, chance = np.median(self.log_power[calm], axis=0), np.median(self.chance[calm], axis=0)
            calm = self.sound & (self.log_power < floor + _WARMTH + _SIGMAS * chance).all(axis=1)
        return calm

    def unevenness(self, calm: Booleans) -> Floats:
        """Return the variance (m,) of the calm windows' log power, as a multiple of the variance due to chance."""
        log_power, chance = self.log_power[calm], np.median(self.chance[calm], axis=0)
        spread = _NORMAL_MAD * np.median(np.abs(log_power - np.median(log_power, axis=0)), axis=0)
        return np.asarray((spread / np.maximum(chance, np.finfo(float).tiny)) ** 2)

    def predictable_shares(self, runs: list[tuple[int, int]]) -> Floats:
        """Return the predictable share (m,) of the power of block means, in runs (first, last) of windows.

        Notes
        -----
        Blocks average out fast noise of any colour, and straight lines through eight windows are subtracted as drift.
        The residual is white for a sensor at rest, and smooth for a sensor in motion.
        """
        lines = [line for first, last in runs for line in _detrended(self.means[first : last + 1 : 2])]
        residuals = np.concatenate(lines) if lines else np.empty((0, self.means.shape[2]))
        return np.array([whiteness(channel).predictable_share for channel in residuals.T])


def window_size(rate_hz: float) -> int:
    """Return the number of readings in a window, a multiple of eight."""
    return _BLOCKS * (max(FEWEST, round(_WINDOW_S * rate_hz)) // _BLOCKS)


def runs_of(calm: Booleans) -> list[tuple[int, int]]:
    """Return the first and the last window of each run of calm windows (W,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], calm, [False]]).astype(int)))
    return [(int(first), int(end) - 1) for first, end in edges.reshape(-1, 2)]


def quantum(channel: Floats) -> float:
    """Return the smallest step between two different readings of a channel (N,), in unit; 0 if all are equal.

    Steps below a billionth of the median level are rounding of the arithmetic, not of the sensor; the largest level may
    be a marker of missing readings.
    """
    levels = np.unique(channel[np.isfinite(channel)])
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * np.median(np.abs(levels))] if len(steps) else steps
    return float(steps.min()) if len(steps) else 0.0


def _measure(channel: Floats, hop: int) -> tuple[Floats, Floats, Floats]:
    """Return the log power (W,), its standard deviation by chance (W,) and block means (W, 8) of a channel (N,).

    Noise smaller than the quantum leaves the readings constant, or toggles their last digit. The quantum's square is
    added to the power, so that both cases have nearly the same power.
    """
    z = _cut(_filled(channel), hop)
    middle = np.median(z, axis=1, keepdims=True)
    kept = int(np.ceil(_KEPT * z.shape[1]))
    least = max(quantum(channel) ** 2, np.finfo(float).tiny)
    power = np.partition((z - middle) ** 2, kept - 1, axis=1)[:, :kept].mean(axis=1) + least
    most = _SPIKE * np.sqrt(power)[:, np.newaxis]
    about = np.clip(z - middle, -most, most).reshape(len(z), _BLOCKS, -1)
    blocks = (about**2).mean(axis=2) + least
    chance = blocks.std(axis=1, ddof=1) / blocks.mean(axis=1) / np.sqrt(_BLOCKS)
    return np.log(power), chance, middle + about.mean(axis=2)


def _slope_power(means: Floats) -> Floats:
    """Return the mean square, (W, m), of the straight lines through block means (W, 8, m)."""
    t = np.arange(_BLOCKS) - (_BLOCKS - 1) / 2
    slope = np.einsum("b,wbm->wm", t, means - means.mean(axis=1, keepdims=True)) / (t @ t)
    return np.asarray(slope**2 * (t @ t) / _BLOCKS)


def _cut(values: NDArray[Value], hop: int) -> NDArray[Value]:
    """Return windows of 2 hop values each, of values (N, ...): an array (W, ..., 2 hop)."""
    return np.lib.stride_tricks.sliding_window_view(values, 2 * hop, axis=0)[::hop]


def _filled(channel: Floats) -> Floats:
    """Return a channel (N,) with each missing reading replaced by the last finite one before it, or by the first."""
    seen = np.flatnonzero(np.isfinite(channel))
    before = np.searchsorted(seen, np.arange(len(channel)), side="right") - 1
    return np.asarray(channel[seen[np.maximum(before, 0)]])


def _detrended(means: Floats) -> list[Floats]:
    """Return block means (w, 8, m) of adjacent windows, in pieces (b, m) less their straight lines."""
    series = means.reshape(-1, means.shape[2])
    pieces = [series[start : start + _DRIFT] for start in range(0, len(series), _DRIFT)]
    return [_residual(piece) for piece in pieces]


def _residual(piece: Floats) -> Floats:
    """Return a piece (b, m) less its regression line."""
    t = np.arange(len(piece)) - (len(piece) - 1) / 2
    centred = piece - piece.mean(axis=0)
    return np.asarray(centred - np.outer(t, t @ centred / (t @ t)))


SHORTEST_S = 1.0
"""Duration of the shortest rest, in seconds; a shorter pause, such as between two movements of a hand, is no rest."""

MOST_PREDICTABLE = 1 / 3
"""Largest predictable share of the power of block means at rest; see `Windows.predictable_shares`."""

MOST_UNEVEN = 3.0
"""Largest variance of the log power at rest, as a multiple of the variance due to chance; see `Windows.unevenness`."""

_NEARLY_ALL = 0.95  # share of rows at rest above which the whole record counts as at rest


class Stretch(NamedTuple):
    """A range of rows, from `start` up to, not including, `stop`."""

    start: int
    stop: int


@dataclass(frozen=True)
class RestPeriods:
    """The rests of a record.

    Attributes
    ----------
    stretches : tuple of Stretch
        The rests, in order and without overlap; empty if there is none.
    reason : str
        A sentence on what was found, or why there is no rest.
    """

    stretches: tuple[Stretch, ...]
    reason: str

    def mask(self, count: int) -> Booleans:
        """Return a mask of the `count` rows of the record, True at rest."""
        still = np.zeros(count, dtype=bool)
        for start, stop in self.stretches:
            still[start:stop] = True
        return still


def detect_rests(recording: Recording, shortest_s: float = SHORTEST_S) -> RestPeriods:
    """Find where all channels of a record are at rest together.

    Parameters
    ----------
    recording : Recording
        The channels of one sensor, or one of them (`Recording.select`): rate, acceleration with gravity, strain with
        its offset; NaN where missing. Spikes and rounding are tolerated. A constant channel is ignored, and so is a
        channel with more than a quarter of its readings missing, if there are others.
    shortest_s : float
        Duration of the shortest rest, in seconds; a *small* one accepts short pauses.

    Returns
    -------
    RestPeriods
        The rests; none if no part of the record can be distinguished from motion.

    Raises
    ------
    RecordingError
        If `shortest_s` is not positive.

    Notes
    -----
    A sensor in uniform motion cannot be distinguished from one at rest: a gyroscope that turns evenly, or a carriage
    that rolls evenly. The edges of a stretch are up to a quarter of a second inside the rest.
    """
    if not 0 < shortest_s < np.inf:
        raise RecordingError(f"shortest_s = {shortest_s} is not a duration; give a positive number of seconds.")
    names = [name for name in recording.names if _varies(recording.channel(name))]
    if not names:
        return RestPeriods((), "No channel varies: without noise, rest cannot be distinguished from a dead sensor.")
    names = [name for name in names if _has_enough_readings(recording.channel(name))] or names
    windows, count = Windows.of(recording.select(names)), len(recording)
    fewest = shortest_s * recording.rate_hz
    if windows is None or count < fewest:
        return RestPeriods((), f"The record is too short: {count} samples at {recording.rate_hz:.4g} Hz.")
    calm = windows.calm(min(max(2, int(np.ceil(fewest / windows.hop))), len(windows.sound)))
    placed = [(run, _rows(run, windows, count)) for run in runs_of(calm)]
    long = [(run, rows) for run, rows in placed if rows.stop - rows.start >= fewest]
    if not long:
        return RestPeriods((), f"The record does not keep its lowest noise for {shortest_s:g} s anywhere.")
    doubt = _doubt(windows.unevenness(calm), windows.predictable_shares([run for run, _ in long]), names)
    if doubt:
        return RestPeriods((), doubt)
    stretches = tuple(rows for _, rows in long)
    return RestPeriods(stretches, _summary(stretches, recording))


def rests_in_spans(recording: Recording, spans_s: Iterable[tuple[float, float]]) -> RestPeriods:
    """Return the rests that a person gives as spans of time.

    Parameters
    ----------
    recording : Recording
        Any channels.
    spans_s : iterable of (float, float)
        Start and end of each rest, in seconds after the first sample; (0, 30) is the first half minute. Overlapping
        spans are joined.

    Raises
    ------
    RecordingError
        If there is no span, or one is reversed, starts before the record or holds under 32 samples.
    """
    since_s = recording.times_s - recording.times_s[:1]
    stretches: list[Stretch] = []
    for begin_s, end_s in sorted(spans_s):
        if not 0 <= begin_s < end_s:
            raise RecordingError(f"{begin_s:g}:{end_s:g} is not a stretch; give from:to in seconds, as 0:30.")
        start, stop = np.searchsorted(since_s, [begin_s, end_s]).tolist()
        if stop - start < FEWEST:
            raise RecordingError(
                f"From {begin_s:g} s to {end_s:g} s there are {stop - start} samples; {FEWEST} are needed. "
                f"The record lasts {recording.timebase.duration_s:g} s; give a longer stretch within it."
            )
        if stretches and start <= stretches[-1].stop:
            start, stop = stretches[-1].start, max(stop, stretches.pop().stop)
        stretches.append(Stretch(start, stop))
    if not stretches:
        raise RecordingError("No stretch was named; give from:to in seconds, as 0:30.")
    return RestPeriods(tuple(stretches), "Said to be still.")


def _varies(channel: Floats) -> bool:
    seen = channel[np.isfinite(channel)]
    return len(seen) > 0 and bool(np.any(seen != seen[0]))


def _has_enough_readings(channel: Floats) -> bool:
    """Return whether a channel has enough readings to show rests; a channel of a lower rate does not."""
    return bool(np.mean(~np.isfinite(channel)) <= MOST_MISSING)


def _rows(run: tuple[int, int], windows: Windows, count: int) -> Stretch:
    """Return the rows that belong to windows of a run only, and to no other window."""
    (first, last), hop = run, windows.hop
    whole = last == len(windows.sound) - 1
    return Stretch((first + 1) * hop if first else 0, count if whole else (last + 1) * hop)


def _doubt(unevenness: Floats, predictable: Floats, names: Sequence[str]) -> str:
    """Return why the quietest parts may not be at rest; "" if they look like noise."""
    worst, smooth = int(np.argmax(unevenness)), int(np.argmax(predictable))
    if predictable[smooth] > MOST_PREDICTABLE:
        return (
            f"The quietest parts still move: {predictable[smooth]:.0%} of the power of {names[smooth]!r} there "
            f"can be predicted, apart from drift; for noise at rest it is under {MOST_PREDICTABLE:.0%}."
        )
    if unevenness[worst] > MOST_UNEVEN:
        return (
            f"The quietest parts are not evenly quiet: the power of {names[worst]!r} there varies "
            f"{unevenness[worst]:.1f} times as much as that of noise at rest."
        )
    return ""


def _summary(stretches: Sequence[Stretch], recording: Recording) -> str:
    still = sum(stop - start for start, stop in stretches)
    if still > _NEARLY_ALL * len(recording):
        share = still / len(recording)
        return f"The noise is even throughout, {share:.0%} of the record: at rest, unless a steady hum is part of it."
    rests = "1 rest" if len(stretches) == 1 else f"{len(stretches)} rests"
    return f"{rests}, {still / recording.rate_hz:.4g} s together, {still / len(recording):.0%} of the record."
