"""Keep some rows of a channel in full detail for a close-up figure."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.rows import EstimatedRows
from becalm.metrics.whiteness import PIECE

_ROWS = 600  # rows of a close-up


class Closeup(Protocol):
    """A selection of rows for a close-up figure, made while a recording is cleaned.

    Attributes
    ----------
    title : str
        Title of the figure, which says which rows it shows.
    kept : (4, k) float array
        Times in seconds, readings, signal and sigma.
    """

    title: str
    kept: Floats

    def add(self, times_s: Floats, z: Floats, estimates: EstimatedRows) -> None:
        """Take the next rows: times (B,) in seconds, readings (B,), and their estimates."""
        ...


class Middle:
    """A close-up of the rows in the middle of a recording."""

    title = "Close up, from the middle of the recording"

    def __init__(self, rows: int) -> None:
        self.kept = np.empty((4, 0))
        self._from = max(0, (rows - _ROWS) // 2)
        self._at = 0

    def add(self, times_s: Floats, z: Floats, estimates: EstimatedRows) -> None:
        """Take the next rows, and keep those in the middle of the recording."""
        start, stop = max(0, self._from - self._at), self._from + _ROWS - self._at
        self._at += len(z)
        if start < len(z) and stop > 0:
            self.kept = np.hstack([self.kept, _stack(times_s, z, estimates, slice(start, stop))])


class Farthest:
    """A close-up of the rows around the reading that is the most sigma away from the signal."""

    title = "Close up, around the reading that is the most sigma away from the signal"

    def __init__(self) -> None:
        self.kept = np.empty((4, 0))
        self._farthest = -1.0

    def add(self, times_s: Floats, z: Floats, estimates: EstimatedRows) -> None:
        """Take the next rows; if they contain the farthest reading so far, keep the rows of this block around it."""
        for first in range(0, len(z), PIECE):  # pieces that fit into the cache
            part = slice(first, first + PIECE)
            with np.errstate(divide="ignore", invalid="ignore"):
                far = np.abs(z[part] - estimates.signal[part]) / estimates.sigma[part]
            far[~np.isfinite(far)] = -1.0
            i = int(np.argmax(far))
            if far[i] > self._farthest:
                self._farthest = float(far[i])
                start = max(0, min(first + i - _ROWS // 2, len(z) - _ROWS))
                self.kept = _stack(times_s, z, estimates, slice(start, start + _ROWS))


def _stack(times_s: Floats, z: Floats, estimates: EstimatedRows, rows: slice) -> Floats:
    return np.vstack([times_s[rows], z[rows], estimates.signal[rows], estimates.sigma[rows]])
