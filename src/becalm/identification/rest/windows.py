"""Cut a record into windows, and test whether a window holds noise only.

Noise has two marks that need no unit and no datasheet: its power is constant, and it cannot be predicted. The quietest
lasting windows set a floor for each channel; windows that stay on it are calm.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Booleans, Floats
from becalm.core.recording import Recording
from becalm.core.time.timebase import GAP_STEPS
from becalm.metrics.whiteness import whiteness

Value = TypeVar("Value", bound=np.generic)

FEWEST = 32
"""Least number of readings in a window."""

MOST_MISSING = 0.25
"""Largest share of readings that may be missing in a window, or in a channel that is used to find rests."""

_NORMAL_MAD = 1.4826  # standard deviation over median absolute deviation
_WINDOW_S = 0.5
_BLOCKS = 8  # in a window
_KEPT = 0.9  # share of a window's readings that set its power: a spike is not motion
_SPIKE = 4.0  # standard deviations of its window
_SIGMAS = 3.5  # standard deviations by chance of the logarithm of a window's power
_WARMTH = 0.25  # change of that logarithm while a sensor warms up
_ROUNDS = 8
_DRIFT = 8 * _BLOCKS  # blocks; a straight line through so many is drift, not motion


class Windows(NamedTuple):
    """W windows of a record of m channels; two adjacent windows overlap by half.

    Attributes
    ----------
    hop : int
        Readings from one window to the next, half of a window.
    log_power : (W, m) float array
        Logarithm of the mean square about the median, in unit^2, without the tenth of readings farthest from it.
    chance : (W, m) float array
        Standard deviation of `log_power` by chance, estimated from the powers of the window's eight blocks.
    means : (W, 8, m) float array
        Means of the blocks, in unit.
    sound : (W,) bool array
        True where a window has enough readings, no gap, and no slope that exceeds the noise.
    """

    hop: int
    log_power: Floats
    chance: Floats
    means: Floats
    sound: Booleans

    @classmethod
    def of(cls, recording: Recording) -> Windows | None:
        """Cut a record into windows of half a second, or of 32 readings; None if it is shorter than one."""
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

    def calm(self, lasting: int) -> Booleans:
        """Return which windows (W,) stay at the level of the quietest `lasting` windows in a row, in all channels."""
        loudness = np.where(self.sound, self.log_power.mean(axis=1), np.inf)
        row = int(np.lib.stride_tricks.sliding_window_view(loudness, lasting).max(axis=1).argmin())
        calm = np.zeros(len(loudness), dtype=bool)
        calm[row : row + lasting] = self.sound[row : row + lasting]
        for _ in range(_ROUNDS):
            if not calm.any():
                break
            floor, chance = np.median(self.log_power[calm], axis=0), np.median(self.chance[calm], axis=0)
            calm = self.sound & (self.log_power < floor + _WARMTH + _SIGMAS * chance).all(axis=1)
        return calm

    def unevenness(self, calm: Booleans) -> Floats:
        """Return the variation of the calm windows' power as a multiple of that by chance, (m,)."""
        log_power, chance = self.log_power[calm], np.median(self.chance[calm], axis=0)
        spread = _NORMAL_MAD * np.median(np.abs(log_power - np.median(log_power, axis=0)), axis=0)
        return np.asarray((spread / np.maximum(chance, np.finfo(float).tiny)) ** 2)

    def foretold(self, runs: list[tuple[int, int]]) -> Floats:
        """Return the share of the power of block means that their past predicts in runs of windows, (m,).

        Notes
        -----
        Blocks average out fast noise of any colour; straight lines through eight windows remove slow drift. The rest is
        white in a sensor at rest, and smooth in motion.
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

    Steps below a billionth of the largest reading are rounding of the arithmetic, not of the sensor.
    """
    levels = np.unique(channel[np.isfinite(channel)])
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * np.abs(levels).max(initial=0.0)]
    return float(steps.min()) if len(steps) else 0.0


def _measure(channel: Floats, hop: int) -> tuple[Floats, Floats, Floats]:
    """Return the log power (W,), its standard deviation by chance (W,) and block means (W, 8) of a channel (N,).

    Noise below the quantum shows as nothing or as a toggling last digit. Adding the quantum's square to the power makes
    both cases alike.
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
    """Return a channel (N,) with each missing reading replaced by the last finite one, or else by the first."""
    seen = np.flatnonzero(np.isfinite(channel))
    before = np.searchsorted(seen, np.arange(len(channel)), side="right") - 1
    return np.asarray(channel[seen[np.maximum(before, 0)]])


def _detrended(means: Floats) -> list[Floats]:
    """Return block means (w, 8, m) of consecutive windows, less straight lines, in pieces (b, m)."""
    series = means.reshape(-1, means.shape[2])
    pieces = [series[start : start + _DRIFT] for start in range(0, len(series), _DRIFT)]
    return [_residual(piece) for piece in pieces]


def _residual(piece: Floats) -> Floats:
    """Return a piece (b, m) less its regression line."""
    t = np.arange(len(piece)) - (len(piece) - 1) / 2
    centred = piece - piece.mean(axis=0)
    return np.asarray(centred - np.outer(t, t @ centred / (t @ t)))
