"""Rows of one channel: the input of a filter, and the output of a filter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Codes, Floats
from becalm.core.reading_verdicts import Verdict

Judge = Callable[[Floats, Floats], None]
"""A function that takes innovations and their expected standard deviations, (B,) each."""


class Rows(NamedTuple):
    """Rows of one channel that a filter takes."""

    z: Floats  # (B,) readings, NaN where missing or rejected
    elapsed: Floats  # (B,) steps since the row before
    verdicts: Codes  # (B,) verdict of each reading so far

    def part(self, which: slice) -> Rows:
        """Return the rows of a slice."""
        return Rows(self.z[which], self.elapsed[which], self.verdicts[which])

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """Return the rows of several parts, concatenated."""
        filled = [part for part in parts if len(part.z)] or parts[:1]
        return filled[0] if len(filled) == 1 else cls(*(np.concatenate(arrays) for arrays in zip(*filled, strict=True)))

    @classmethod
    def empty(cls) -> Rows:
        """Return an object of zero rows."""
        return cls(np.empty(0), np.empty(0), np.empty(0, np.int8))


class EstimatedRows(NamedTuple):
    """Estimates of one channel's rows by a filter or a smoother."""

    signal: Floats  # (B,) in unit
    sigma: Floats  # (B,) in unit
    parts: Floats  # (p, B) contribution of each part of the model if requested, otherwise (0, B)
    verdicts: Codes  # (B,) `Verdict` of each reading

    def rows(self, which: slice) -> EstimatedRows:
        """Return the rows of a slice."""
        return EstimatedRows(self.signal[which], self.sigma[which], self.parts[:, which], self.verdicts[which])

    def without(self, which: Booleans, verdict: Verdict) -> EstimatedRows:
        """Return a copy in which the estimates of some rows (B,) are NaN and have the given verdict."""
        if not which.any():
            return self
        signal, sigma, parts = (np.where(which, np.nan, array) for array in self[:3])
        return EstimatedRows(signal, sigma, parts, np.where(which, np.int8(verdict), self.verdicts))

    @classmethod
    def joined(cls, parts: Sequence[EstimatedRows]) -> EstimatedRows:
        """Return the rows of several parts, concatenated."""
        filled = [part for part in parts if len(part.signal)] or [cls.empty()]
        if len(filled) == 1:
            return filled[0]
        return cls(*(np.concatenate(arrays, axis=-1) for arrays in zip(*filled, strict=True)))

    @classmethod
    def empty(cls) -> EstimatedRows:
        """Return an object of zero rows."""
        return cls(np.empty(0), np.empty(0), np.empty((0, 0)), np.empty(0, np.int8))
