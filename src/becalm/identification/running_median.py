"""Compute the running median of five readings, which two adjacent outliers do not move."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from becalm.core.arrays import Floats

WINDOW = 5
"""Number of readings in a window."""

_PIECE = 1 << 16


def running_median(z: Floats) -> Floats:
    """Return the median of the five readings around each of z (N,), N at least 5; at an end, of the last five."""
    half, inner = WINDOW // 2, np.empty(len(z) - WINDOW + 1)
    for start in range(0, len(inner), _PIECE):
        windows = sliding_window_view(z[start : start + _PIECE + WINDOW - 1], WINDOW)
        inner[start : start + _PIECE] = np.median(windows, axis=1)
    return np.pad(inner, half, mode="edge")
