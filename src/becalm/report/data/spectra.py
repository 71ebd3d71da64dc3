"""Estimate the spectrum of a sequence of any length from segments spread over it."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from becalm.core.arrays import Floats
from becalm.metrics.spectrum import Spectrum

_LONGEST, _SHORTEST = 4096, 16  # samples in a segment
_FEWEST = 8  # number of segments, without overlap, of a short record
_MOST = 256  # approximate number of segments of a long record


class RunningSpectrum:
    """Welch's estimate of the spectrum of a sequence that arrives in blocks.

    Of a long sequence, about 256 segments at equal distances are used, or one of each block if there are more blocks.
    Segments with a missing value, and segments across the border of two blocks, are left out.

    Parameters
    ----------
    rows : int
        Total number of samples.
    rate_hz : float
        Samples per second.

    Notes
    -----
    Welch, IEEE Transactions on Audio and Electroacoustics 15 (1967) 70: Hann windows; in a short sequence, half
    overlapping.
    """

    def __init__(self, rows: int, rate_hz: float) -> None:
        wanted = max(_SHORTEST, min(_LONGEST, rows // _FEWEST))
        self._segment = 1 << (wanted.bit_length() - 1)
        self._spacing = max(self._segment // 2, rows // _MOST)
        self._rate_hz = rate_hz
        self._density = np.zeros(self._segment // 2 + 1)
        self._frequency_hz = np.arange(self._segment // 2 + 1.0) * rate_hz / self._segment
        self._segments = 0

    def add(self, values: Floats, instead: Floats | None = None) -> None:
        """Add a block of values (B,), NaN where missing; values of `instead` (B,) replace the missing values."""
        if len(values) < self._segment:
            return
        segments = self._spread(values)
        if instead is not None:
            segments = np.where(np.isnan(segments), self._spread(instead), segments)
        whole = segments[np.isfinite(segments.sum(axis=1))]
        if len(whole):
            from scipy.signal import periodogram

            _, density = periodogram(whole, self._rate_hz, window="hann")
            self._density += density.sum(axis=0)
            self._segments += len(whole)

    def _spread(self, values: Floats) -> Floats:
        return sliding_window_view(values, self._segment)[:: self._spacing]

    def result(self) -> Spectrum | None:
        """Return the spectrum without 0 Hz; None if no segment was complete."""
        if not self._segments:
            return None
        return Spectrum(self._frequency_hz[1:], self._density[1:] / self._segments)
