"""What a record holds at which frequency: Welch's spectrum, and its bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats

VEHICLE_BANDS_HZ = {"body": (1.0, 3.0), "wheels": (4.0, 8.0), "sprung and unsprung masses": (10.0, 20.0)}
"""Of the car paper."""

_SEGMENT = 1024


class Spectrum(NamedTuple):
    """A power density, one-sided."""

    frequency_hz: Floats  # (k,)
    density: Floats  # (k,) unit^2/Hz

    def power(self, low_hz: float, high_hz: float) -> float:
        """Return the power, in unit^2, of a band."""
        inside = (self.frequency_hz >= low_hz) & (self.frequency_hz <= high_hz)
        return float(np.trapezoid(self.density[inside], self.frequency_hz[inside]))


def welch(z: Floats, rate_hz: float, segment: int = _SEGMENT) -> Spectrum:
    """Return the spectrum of a record (N,) without gaps, by Welch's method: Hann windows, half overlapping.

    Parameters
    ----------
    z : (N,) float array
        In unit; its mean is taken off each segment.
    rate_hz : float
        Of its samples.
    segment : int
        Samples of a segment; a *small* one blurs, and scatters less.

    Notes
    -----
    Welch, IEEE Transactions on Audio and Electroacoustics 15 (1967) 70.
    """
    from scipy.signal import welch as scipy_welch

    return Spectrum(*scipy_welch(z, fs=rate_hz, nperseg=min(segment, len(z))))


class Spectrogram(NamedTuple):
    """How a power density changes over time, one-sided."""

    times_s: Floats  # (t,) middles of the segments, since the first sample
    frequency_hz: Floats  # (k,)
    density: Floats  # (k, t) unit^2/Hz


def spectrogram(z: Floats, rate_hz: float, segment: int = _SEGMENT) -> Spectrogram:
    """Return the spectra of a record (N,) without gaps, segment by segment: Hann windows, half overlapping.

    Parameters
    ----------
    z : (N,) float array
        In unit; its mean is taken off each segment.
    rate_hz : float
        Of its samples.
    segment : int
        Samples of a segment; a *small* one blurs frequencies, and tells sooner what changes.

    Notes
    -----
    Welch's spectrum is its mean over time.
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
