"""Rows of a stream that wait in a fixed-lag filter for later ones."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import ModelError


class Waiting:
    """Rows that were read and not told yet, of a filter with a lag; some may have been told when the stream ended."""

    def __init__(self, width: int) -> None:
        self.time_s, self.values = np.empty(0), np.empty((0, width))
        self.told = 0  # of the first ones, at an end that was none

    @property
    def count(self) -> int:
        """How many wait."""
        return len(self.time_s)

    def rows(self, first: int) -> tuple[Floats, Floats]:
        """Return stamps and readings of those that wait, from one on; they stay."""
        return self.time_s[first:], self.values[first:]

    def through(self, time_s: Floats, values: Floats, ready: int) -> tuple[Floats, Floats, int]:
        """Add rows at the end and take `ready` from the front; return those not told yet, and how many were."""
        time_s, values = np.concatenate([self.time_s, time_s]), np.concatenate([self.values, values])
        self.time_s, self.values = time_s[ready:].copy(), values[ready:].copy()
        again = min(self.told, ready)
        self.told -= again
        return time_s[again:ready], values[again:ready], again

    def restore(self, time_s: Floats, values: Floats, told: int) -> None:
        """Take over what waited in a stream that was stopped; a ModelError if that is not what it says."""
        if values.shape != (len(time_s), self.values.shape[1]) or not 0 <= told <= len(time_s):
            raise ModelError("The stream's snapshot is damaged; begin a new stream in another folder.")
        self.time_s, self.values, self.told = time_s, values, told
