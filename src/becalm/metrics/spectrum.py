"""Power spectrum of a record by Welch's method, and the power of frequency bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats

VEHICLE_BANDS_HZ = {"body": (1.0, 3.0), "wheels": (4.0, 8.0), "sprung and unsprung masses": (10.0, 20.0)}
"""Frequency bands of the car paper, in hertz."""

_SEGMENT = 1024  # samples


class Spectrum(NamedTuple):
    """A one-sided power spectral density."""

    frequency_hz: Floats  # (k,)
    density: Floats  # (k,) unit^2/Hz

    def power(self, low_hz: float, high_hz: float) -> float:
        """Return the power of the band from `low_hz` to `high_hz`, in unit^2."""
        inside = (self.frequency_hz >= low_hz) & (self.frequency_hz <= high_hz)
        return float(np.trapezoid(self.density[inside], self.frequency_hz[inside]))


def welch(z: Floats, rate_hz: float, segment: int = _SEGMENT) -> Spectrum:
    """Return the spectrum of a record (N,) without gaps, by Welch's method with half-overlapping Hann windows.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit; the mean of each segment is subtracted.
    rate_hz : float
        Sampling rate, in hertz.
    segment : int
        Samples per segment; a *small* number gives a coarser frequency resolution and less scatter.

    Notes
    -----
    Welch, IEEE Transactions on Audio and Electroacoustics 15 (1967) 70.
    """
    from scipy.signal import welch as scipy_welch

    return Spectrum(*scipy_welch(z, fs=rate_hz, nperseg=min(segment, len(z))))


class Spectrogram(NamedTuple):
    """A one-sided power spectral density over time."""

    times_s: Floats  # (t,) centres of the segments, in seconds after the first sample
    frequency_hz: Floats  # (k,)
    density: Floats  # (k, t) unit^2/Hz


def spectrogram(z: Floats, rate_hz: float, segment: int = _SEGMENT) -> Spectrogram:
    """Return the spectra of half-overlapping segments, with Hann windows, of a record (N,) without gaps.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit; the mean of each segment is subtracted.
    rate_hz : float
        Sampling rate, in hertz.
    segment : int
        Samples per segment; a *small* number resolves time better and frequency worse.

    Notes
    -----
    The mean of the result over time is the spectrum of `welch`.
    """
    from scipy.signal import ShortTimeFFT
    from scipy.signal.windows import hann

    size = min(segment, len(z))
    hop = max(1, size // 2)
    framed = ShortTimeFFT(hann(size, sym=False), hop, rate_hz, fft_mode="onesided2X", scale_to="psd")
    first, last = framed.lower_border_end[1], framed.upper_border_begin(len(z))[1]
    density = framed.spectrogram(z, detr="constant", p0=first, p1=last)
    return Spectrogram(framed.t(len(z), p0=first, p1=last), framed.f, density)


def band_powers(spectrum: Spectrum, bands_hz: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Return the power of each band, in unit^2."""
    return {name: spectrum.power(*band) for name, band in bands_hz.items()}
