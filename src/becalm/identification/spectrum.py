"""Compute the power spectrum of a record, also averaged in bins, and that of a tone in closed form.

Frequencies are angles, in radians per step; the power of white noise is its variance, in unit^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from becalm.core.arrays import Floats

_RESOLUTION = 0.02  # width of a bin, as a share of its frequency
_ENDS = 8  # readings whose mean is the level at the start of a record, or at its end
_FIRST = 4  # lowest frequency kept, in cycles per record; the window leaks the level into lower ones
_UNBINNED = 60  # frequencies on each side of a tone that are not binned


class BinnedPeriodogram(NamedTuple):
    """The power spectrum of a record, averaged over bins of frequencies."""

    angle: Floats  # (k,) mean frequency of each bin, radians a step
    power: Floats  # (k,) mean power, unit^2
    weight: Floats  # (k,) number of frequencies in each bin


class ToneOscillator(NamedTuple):
    """A tone: an oscillator that is driven by white noise.

    Attributes
    ----------
    angle : float
        Frequency, in radians per step.
    damping : float
        Decay rate, in 1/step; a *small* one trusts the tone to keep its phase.
    density : float
        Density of the noise on each of its two states, in unit^2/step; a *small* one trusts the tone, and lets
        amplitude and phase change slowly.
    disturbance : bool
        Whether it is a disturbance: present in the readings, not part of the signal.
    """

    angle: float
    damping: float
    density: float
    disturbance: bool = False


def sine_spectrum(z: Floats) -> BinnedPeriodogram:
    """Return the power spectrum of a record (N,), less the line between its ends, by the sine transform.

    This is the spectrum of the record continued at both ends by its odd reflection, which adds no jumps and no kinks.
    White noise stays white, and every reading has the same weight. Therefore the sum of the squared residuals of a
    smoother with gain G is the sum of (1 - G)^2 times this power.
    """
    from scipy.fft import dst

    place = np.arange(len(z)) - (_ENDS - 1) / 2
    power = dst(z - (z[:_ENDS].mean() + slope_between_ends(z) * place), type=1, norm="ortho") ** 2
    angle = np.pi * np.arange(1, len(z) + 1) / (len(z) + 1)
    return _gather(angle, power, [])


def slope_between_ends(z: Floats) -> float:
    """Return the slope, unit a step, of the line between the ends of a record (N,)."""
    return float((z[-_ENDS:].mean() - z[:_ENDS].mean()) / (len(z) - _ENDS))


def pooled(spectra: Sequence[BinnedPeriodogram]) -> BinnedPeriodogram:
    """Return the spectra of several records as one."""
    return BinnedPeriodogram(*(np.concatenate(parts) for parts in zip(*spectra, strict=True)))


def periodogram(z: Floats) -> BinnedPeriodogram:
    """Return the periodogram of a record (N,) with a Hann window, one frequency per bin.

    The four lowest frequencies and the one or two highest are left out.
    """
    from scipy.fft import rfft

    window = np.hanning(len(z) + 2)[1:-1]
    power = np.abs(np.asarray(rfft((z - z.mean()) * window))) ** 2 / (window**2).sum()
    angle = 2 * np.pi * np.arange(len(power)) / len(z)
    kept = slice(_FIRST, (len(z) - 1) // 2)
    return BinnedPeriodogram(angle[kept], power[kept], np.ones(kept.stop - _FIRST))


def welch_power(z: Floats, window: Floats) -> Floats:
    """Return the mean power (w // 2 + 1,), unit^2, of segments of a record (N,), from 0 to half the rate.

    Parameters
    ----------
    z : (N,) float array
        Readings in unit, at least as many as the window is long.
    window : (w,) float array
        Window. It multiplies each segment less the segment's mean; segments overlap by half.

    Notes
    -----
    Welch, IEEE TAU-15 (1967) 70. The power of white noise is its variance at every frequency.
    """
    size = len(window)
    segments = np.lib.stride_tricks.sliding_window_view(z, size)[:: size // 2]
    tapered = (segments - segments.mean(axis=1, keepdims=True)) * window
    power: Floats = (np.abs(np.fft.rfft(tapered, axis=1)) ** 2).mean(axis=0) / (window**2).sum()
    return power


def binned(spectrum: BinnedPeriodogram, tones: Sequence[ToneOscillator]) -> BinnedPeriodogram:
    """Return a spectrum averaged in bins of frequencies, except for the frequencies near a tone."""
    spacing = spectrum.angle[1] - spectrum.angle[0]
    places = [round((tone.angle - spectrum.angle[0]) / spacing) for tone in tones]
    return _gather(spectrum.angle, spectrum.power, places)


def _gather(angle: Floats, power: Floats, tones: Sequence[int]) -> BinnedPeriodogram:
    """Average frequencies in bins, except those near the indices `tones`."""
    unbinned = np.zeros(len(angle), dtype=bool)
    for tone in tones:
        unbinned[max(0, tone - _UNBINNED) : tone + _UNBINNED + 1] = True
    starts, at = [], 0
    while at < len(angle):
        starts.append(at)
        width = max(1, int(_RESOLUTION * (at + _FIRST)))
        at += 1 if unbinned[at : at + width].any() else width
    first = np.array(starts)
    weight = np.diff(np.append(first, len(angle))).astype(np.float64)
    return BinnedPeriodogram(np.add.reduceat(angle, first) / weight, np.add.reduceat(power, first) / weight, weight)


def tone_power(tone: ToneOscillator, angle: Floats) -> Floats:
    """Return the power (k,), unit^2, of a tone, sampled once a step, at angles (k,) in radians per step."""
    shrunk = np.exp(-tone.damping)
    variance = tone.density * -np.expm1(-2 * tone.damping) / (2 * tone.damping)
    real, imaginary, turn = shrunk * np.cos(tone.angle), shrunk * np.sin(tone.angle), np.exp(1j * angle)
    power: Floats = (
        variance * (np.abs(turn - real) ** 2 + imaginary**2) / np.abs((turn - real) ** 2 + imaginary**2) ** 2
    )
    return power


# Compute the running median of five readings, which two adjacent outliers do not change much.

WINDOW = 5
"""Number of readings in a window."""

_PIECE = 1 << 16  # windows that are sorted at once


def running_median(z: Floats) -> Floats:
    """Return the median of the five readings around each of z (N,), N at least 5; near an end, of the last five."""
    half, inner = WINDOW // 2, np.empty(len(z) - WINDOW + 1)
    for start in range(0, len(inner), _PIECE):
        windows = sliding_window_view(z[start : start + _PIECE + WINDOW - 1], WINDOW)
        inner[start : start + _PIECE] = np.median(windows, axis=1)
    return np.pad(inner, half, mode="edge")
