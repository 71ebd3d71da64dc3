"""The median of five neighbours: what two wild readings side by side do not move."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from becalm.core.arrays import Floats

WINDOW = 5
"""Readings whose median is taken."""

_PIECE = 1 << 16


def running_median(z: Floats) -> Floats:
    """Return the median of five neighbours of each of z (N,), N at least 5; at the ends, of the five there."""
    half, inner = WINDOW // 2, np.empty(len(z) - WINDOW + 1)
    for start in range(0, len(inner), _PIECE):
        windows = sliding_window_view(z[start : start + _PIECE + WINDOW - 1], WINDOW)
        inner[start : start + _PIECE] = np.median(windows, axis=1)
    return np.pad(inner, half, mode="edge")
