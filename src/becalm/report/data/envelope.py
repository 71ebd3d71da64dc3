"""Reduce millions of samples to the minimum and maximum of each of a few thousand stretches, which keeps spikes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Codes, Floats

Cut = tuple[slice, NDArray[np.intp]]
"""The division of a block of rows: its stretches, and the block's row at which each of them begins."""


class Stretches:
    """A division of rows, which arrive in blocks, into stretches of equal length.

    Parameters
    ----------
    rows : int
        Total number of rows.
    most : int
        Largest number of stretches; with a *small* number, each stretch has more rows.

    Attributes
    ----------
    rows_each : int
        Rows in each stretch; the last stretch may have fewer.
    count : int
        Number of stretches.
    """

    def __init__(self, rows: int, most: int) -> None:
        self.rows_each = max(1, -(-rows // most))
        self.count = max(1, -(-rows // self.rows_each))
        self._at = 0  # number of rows of all earlier blocks

    def next(self, rows: int) -> Cut:
        """Divide the next block; return its stretches, and the block's row at which each of them begins.

        Parameters
        ----------
        rows : int
            Number of rows in the block.
        """
        first, inside = divmod(self._at, self.rows_each)
        begins = np.append(0, np.arange(self.rows_each - inside, rows, self.rows_each))
        self._at += rows
        return slice(first, first + len(begins)), begins


class Envelope:
    """The minimum and maximum of each stretch of a sequence; NaN values are ignored.

    Attributes
    ----------
    low, high : (count,) float array
        Minimum and maximum of each stretch; NaN where a stretch has no value.
    """

    def __init__(self, count: int) -> None:
        self.low, self.high = np.full(count, np.nan), np.full(count, np.nan)

    @classmethod
    def of(cls, values: Floats, most: int) -> Envelope:
        """Return the envelope of a complete sequence (N,) in at most `most` stretches."""
        stretches = Stretches(len(values), most)
        envelope = cls(stretches.count)
        envelope.add(*stretches.next(len(values)), values, values)
        return envelope

    def add(self, touched: slice, begins: NDArray[np.intp], low: Floats, high: Floats) -> None:
        """Add a block of lower and upper values (B,), which `Stretches.next` has divided."""
        if len(low):
            self.low[touched] = np.fmin(self.low[touched], np.fmin.reduceat(low, begins))
            self.high[touched] = np.fmax(self.high[touched], np.fmax.reduceat(high, begins))


class VerdictsByStretch:
    """The verdict codes, from 0 to 15, that occur in each stretch of a sequence.

    Attributes
    ----------
    bits : (count,) uint16 array
        For each stretch, one bit for each code that occurs, except code 0.
    """

    def __init__(self, count: int) -> None:
        self.bits = np.zeros(count, np.uint16)

    def add(self, touched: slice, begins: NDArray[np.intp], codes: Codes) -> None:
        """Add a block of codes (B,), which `Stretches.next` has divided."""
        if codes.any():
            bits = np.left_shift(np.uint16(1), codes.astype(np.uint16)) & np.uint16(0xFFFE)
            self.bits[touched] |= np.bitwise_or.reduceat(bits, begins)

    def runs(self, code: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the first stretch of each run of stretches in which a code occurs, and the stretch after the run."""
        inside = np.append(np.append(False, self.bits & (1 << code) != 0), False)
        edges = np.flatnonzero(inside[1:] != inside[:-1])
        return edges[::2], edges[1::2]


class Means:
    """The mean of each stretch of a sequence; NaN values are ignored.

    Attributes
    ----------
    seen : (count,) float array
        Number of values in each stretch, without NaN.
    """

    def __init__(self, count: int) -> None:
        self.seen, self._total = np.zeros(count), np.zeros(count)

    def add(self, touched: slice, begins: NDArray[np.intp], values: Floats) -> None:
        """Add a block of values (B,), which `Stretches.next` has divided."""
        if not len(values):
            return
        sizes = np.diff(np.append(begins, len(values)))
        total = np.add.reduceat(values, begins)
        if not np.isfinite(total).all():
            finite = np.isfinite(values)
            sizes, total = (
                np.add.reduceat(finite.astype(np.intp), begins),
                np.add.reduceat(np.where(finite, values, 0.0), begins),
            )
        self.seen[touched] += sizes
        self._total[touched] += total

    def result(self) -> Floats:
        """Return the means (count,); NaN where a stretch has no value."""
        means = np.full(len(self.seen), np.nan)
        np.divide(self._total, self.seen, out=means, where=self.seen > 0)
        return means
