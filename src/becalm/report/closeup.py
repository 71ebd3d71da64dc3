"""Some rows of a channel as they are, each reading by itself."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.rows import EstimatedRows
from becalm.metrics.running import PIECE

_ROWS = 600


class Closeup(Protocol):
    """Keeps a few rows of those that go by.

    Attributes
    ----------
    title : str
        Which rows they are.
    kept : (4, k) float array
        Times in seconds, readings, signal and sigma.
    """

    title: str
    kept: Floats

    def add(self, times_s: Floats, z: Floats, told: EstimatedRows) -> None:
        """Take the next rows: times (B,), readings (B,), and what is told of them."""
        ...


class Middle:
    """Keeps the rows at the middle of a recording."""

    title = "Close up, from the middle of the recording"

    def __init__(self, rows: int) -> None:
        self.kept = np.empty((4, 0))
        self._from = max(0, (rows - _ROWS) // 2)
        self._at = 0

    def add(self, times_s: Floats, z: Floats, told: EstimatedRows) -> None:
        """Take the next rows."""
        start, stop = max(0, self._from - self._at), self._from + _ROWS - self._at
        self._at += len(z)
        if start < len(z) and stop > 0:
            self.kept = np.hstack([self.kept, _stack(times_s, z, told, slice(start, stop))])


class Farthest:
    """Keeps the rows about the reading that lies the most sigma from the signal."""

    title = "Close up, where a reading lies the most sigma from the signal"

    def __init__(self) -> None:
        self.kept = np.empty((4, 0))
        self._farthest = -1.0

    def add(self, times_s: Floats, z: Floats, told: EstimatedRows) -> None:
        """Take the next rows; what is kept does not reach beyond a block of them."""
        for first in range(0, len(z), PIECE):  # which stay in the cache
            part = slice(first, first + PIECE)
            with np.errstate(divide="ignore", invalid="ignore"):
                far = np.abs(z[part] - told.signal[part]) / told.sigma[part]
            far[~np.isfinite(far)] = -1.0
            i = int(np.argmax(far))
            if far[i] > self._farthest:
                self._farthest = float(far[i])
                start = max(0, min(first + i - _ROWS // 2, len(z) - _ROWS))
                self.kept = _stack(times_s, z, told, slice(start, start + _ROWS))


def _stack(times_s: Floats, z: Floats, told: EstimatedRows, rows: slice) -> Floats:
    return np.vstack([times_s[rows], z[rows], told.signal[rows], told.sigma[rows]])
