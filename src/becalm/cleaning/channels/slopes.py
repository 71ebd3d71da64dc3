"""Compute the slope of a clean signal, the noise from uncertain times of readings, and warn about a resonance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from becalm.cleaning.recipes.recipe_parts import TimingRecipe
from becalm.core.arrays import Floats
from becalm.core.rows import EstimatedRows
from becalm.sensors.resonance import Resonance

_NOTICEABLE = 0.001  # least relative increase of sigma that is reported


class Slopes:
    """The backward differences of a signal in blocks; the division into blocks does not change the result.

    Parameters
    ----------
    step_s : float
        Length of one step, in seconds; elapsed time is counted in steps.
    """

    def __init__(self, step_s: float) -> None:
        self._step_s, self._last, self._slope = step_s, np.nan, 0.0

    def of(self, signal: Floats, elapsed: Floats) -> Floats:
        """Return the slope at the next rows, (B,), in unit/s.

        Where no time has elapsed, or the signal is NaN, the slope is that of the previous row.

        Parameters
        ----------
        signal : (B,) float array
            Clean signal, in unit.
        elapsed : (B,) float array
            Steps since the previous row.
        """
        if not len(signal):
            return np.empty(0)
        differences = np.diff(signal, prepend=self._last)
        valid = (elapsed > 0.0) & np.isfinite(differences)
        slopes = np.divide(differences, elapsed * self._step_s, out=np.full(len(signal), self._slope), where=valid)
        latest = np.maximum.accumulate(np.where(valid, np.arange(len(signal)), -1))
        slopes = np.where(latest >= 0, slopes[latest], self._slope)
        self._last, self._slope = float(signal[-1]), float(slopes[-1])
        return slopes

    def state_dict(self) -> Floats:
        """Return the state as an array."""
        return np.array([self._last, self._slope])

    def load_state_dict(self, state: Floats) -> None:
        """Restore the state that `state_dict` returned."""
        self._last, self._slope = state.tolist()


class TimingNoise:
    """A widening of sigma for the noise that uncertain times of readings add.

    Parameters
    ----------
    timing : TimingRecipe
        Uncertainty of the times.
    noise_std : float
        Standard deviation of a reading's noise, in unit.
    step_s : float
        One step, in seconds.
    """

    def __init__(self, timing: TimingRecipe, noise_std: float, step_s: float) -> None:
        self._timing, self._variance, self._slopes = timing, noise_std**2, Slopes(step_s)
        self._elapsed: list[Floats] = []
        self.largest_share = 0.0
        """Largest relative increase of sigma so far."""

    def push(self, elapsed: Floats) -> None:
        """Take the steps since the previous row, (B,), for each of the next rows."""
        self._elapsed.append(elapsed)

    def widened(self, estimates: EstimatedRows) -> EstimatedRows:
        """Return the estimates of the next rows with a wider sigma."""
        slopes = self._slopes.of(estimates.signal, self._take_elapsed(len(estimates.signal)))
        extra_variance = (slopes * self._timing.std_s) ** 2 - self._timing.included_std**2
        factor = np.sqrt(1.0 + np.maximum(extra_variance, 0.0) / self._variance)
        self.largest_share = max(self.largest_share, float(factor.max(initial=1.0)) - 1.0)
        return estimates._replace(sigma=factor * estimates.sigma)

    def state_dict(self) -> dict[str, Floats]:
        """Return the state as arrays."""
        return {
            "timing_slopes": self._slopes.state_dict(),
            "timing_elapsed": np.concatenate([*self._elapsed, np.empty(0)]),
        }

    def load_state_dict(self, arrays: Mapping[str, Floats]) -> None:
        """Restore the state that `state_dict` returned."""
        self._slopes.load_state_dict(arrays["timing_slopes"])
        self._elapsed = [arrays["timing_elapsed"]]

    def _take_elapsed(self, count: int) -> Floats:
        """Remove the steps of the next `count` rows from the queue and return them."""
        waiting = np.concatenate([*self._elapsed, np.empty(0)])
        self._elapsed = [waiting[count:]]
        return waiting[:count]


def timing_sentences(timing: TimingRecipe | None, share: float) -> list[str]:
    """Return a sentence on the largest relative increase of sigma, `share`, if it is noticeable."""
    if timing is None or share < _NOTICEABLE:
        return []
    return [f"An uncertainty of {1e6 * timing.std_s:.3g} us in time increases sigma by up to {share:.1%}."]


# Check whether the clean signal contains frequencies at which the sensor's resonance distorts amplitudes.

FLAT_PERCENT = 5.0
"""Largest error of an amplitude in the flat band of a sensor, in percent."""


def resonance_warning(name: str, resonance: Resonance, passed_hz: float | None, rate_hz: float) -> str:
    """Return a warning if the clean signal contains frequencies above the sensor's flat band (5 %); "" otherwise.

    Parameters
    ----------
    name : str
        Name of the channel.
    resonance : Resonance
        Resonance of the channel's sensor.
    passed_hz : float or None
        -3 dB bandwidth of the filter; None if it is unknown, or no filter was chosen.
    rate_hz : float
        Rate of the rows, which contain frequencies up to half of this rate.
    """
    flat_hz, nyquist_hz = resonance.accurate_to_hz(FLAT_PERCENT), rate_hz / 2
    band_hz = nyquist_hz if passed_hz is None else min(passed_hz, nyquist_hz)
    if band_hz <= flat_hz:
        return ""
    what = f"its rows, at {rate_hz:.6g} Hz, contain frequencies" if passed_hz is None else "its filter passes"
    return (
        f"{name}: {what} up to {band_hz:.4g} Hz, but its sensor, with a resonance at {resonance.natural_hz:.6g} Hz and"
        f" a damping ratio of {resonance.damping_ratio:g}, measures amplitudes within {FLAT_PERCENT:g} % only up to"
        f" {flat_hz:.4g} Hz. Do not trust amplitudes above it, or remove them with --bandwidth {flat_hz:.3g}Hz."
    )
