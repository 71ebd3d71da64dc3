"""Rows of a channel before a filter, and after it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Codes, Floats
from becalm.core.verdict import Verdict

Judge = Callable[[Floats, Floats], None]
"""Takes innovations and their expected standard deviations, (B,) each."""


class Rows(NamedTuple):
    """Some rows of one channel, before a filter."""

    z: Floats  # (B,) readings, NaN where none may enter
    elapsed: Floats  # (B,) steps since the row before
    verdicts: Codes  # (B,) what became of each reading so far

    def part(self, which: slice) -> Rows:
        """Return some of the rows."""
        return Rows(self.z[which], self.elapsed[which], self.verdicts[which])

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """Return rows one after the other."""
        some = [part for part in parts if len(part.z)] or parts[:1]
        return some[0] if len(some) == 1 else cls(*(np.concatenate(arrays) for arrays in zip(*some, strict=True)))

    @classmethod
    def nothing(cls) -> Rows:
        """Return no rows."""
        return cls(np.empty(0), np.empty(0), np.empty(0, np.int8))


class EstimatedRows(NamedTuple):
    """Some rows of one channel, after a filter or a smoother."""

    signal: Floats  # (B,)
    sigma: Floats  # (B,)
    parts: Floats  # (p, B) the share of each part, where they were asked for; otherwise (0, B)
    verdicts: Codes  # (B,) what became of each reading, see `Verdict`

    def rows(self, which: slice) -> EstimatedRows:
        """Return some of the rows."""
        return EstimatedRows(self.signal[which], self.sigma[which], self.parts[:, which], self.verdicts[which])

    def without(self, which: Booleans, verdict: Verdict) -> EstimatedRows:
        """Return the same without estimates in some rows (B,), which get a verdict."""
        if not which.any():
            return self
        signal, sigma, parts = (np.where(which, np.nan, one) for one in self[:3])
        return EstimatedRows(signal, sigma, parts, np.where(which, np.int8(verdict), self.verdicts))

    @classmethod
    def joined(cls, parts: Sequence[EstimatedRows]) -> EstimatedRows:
        """Return rows one after the other."""
        some = [part for part in parts if len(part.signal)] or [cls.nothing()]
        return some[0] if len(some) == 1 else cls(*(np.concatenate(of, axis=-1) for of in zip(*some, strict=True)))

    @classmethod
    def nothing(cls) -> EstimatedRows:
        """Return no rows."""
        return cls(np.empty(0), np.empty(0), np.empty((0, 0)), np.empty(0, np.int8))
