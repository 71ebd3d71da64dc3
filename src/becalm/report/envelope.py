"""Millions of samples in a few thousand stretches, each by its least and its greatest, so that no spike is lost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Codes, Floats

Cut = tuple[slice, NDArray[np.intp]]
"""How a block of rows is cut: which stretches it touches, and where in the block each of them begins."""


class Stretches:
    """How rows that come in blocks fall into stretches of equally many.

    Parameters
    ----------
    rows : int
        How many will come.
    most : int
        How many stretches there may be; a *small* number joins more rows in each.

    Attributes
    ----------
    rows_each, count : int
        Rows of a stretch, the last of which may have fewer, and how many stretches there are.
    """

    def __init__(self, rows: int, most: int) -> None:
        self.rows_each = max(1, -(-rows // most))
        self.count = max(1, -(-rows // self.rows_each))
        self._at = 0  # rows so far

    def next(self, rows: int) -> Cut:
        """Take a block of rows: return which stretches it touches, and where in the block each of them begins."""
        first, inside = divmod(self._at, self.rows_each)
        begins = np.append(0, np.arange(self.rows_each - inside, rows, self.rows_each))
        self._at += rows
        return slice(first, first + len(begins)), begins


class Envelope:
    """The least and the greatest of each stretch of a sequence; NaN counts as none.

    Attributes
    ----------
    low, high : (count,) float array
        NaN where nothing came.
    """

    def __init__(self, count: int) -> None:
        self.low, self.high = np.full(count, np.nan), np.full(count, np.nan)

    @classmethod
    def of(cls, values: Floats, most: int) -> Envelope:
        """Return the envelope of all of a sequence (N,), in up to `most` stretches."""
        stretches = Stretches(len(values), most)
        found = cls(stretches.count)
        found.add(*stretches.next(len(values)), values, values)
        return found

    def add(self, touched: slice, begins: NDArray[np.intp], low: Floats, high: Floats) -> None:
        """Add a block (B,), as `Stretches.next` has cut it: its lower edge and its upper one."""
        if len(low):
            self.low[touched] = np.fmin(self.low[touched], np.fmin.reduceat(low, begins))
            self.high[touched] = np.fmax(self.high[touched], np.fmax.reduceat(high, begins))


class Kinds:
    """Which codes, from 0 to 15, came up in each stretch of a sequence.

    Attributes
    ----------
    met : (count,) uint16 array
        A bit for each code but 0.
    """

    def __init__(self, count: int) -> None:
        self.met = np.zeros(count, np.uint16)

    def add(self, touched: slice, begins: NDArray[np.intp], codes: Codes) -> None:
        """Add a block (B,) of codes, as `Stretches.next` has cut it."""
        if codes.any():
            bits = np.left_shift(np.uint16(1), codes.astype(np.uint16)) & np.uint16(0xFFFE)
            self.met[touched] |= np.bitwise_or.reduceat(bits, begins)

    def runs(self, code: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the stretches in which a code came up, as runs: the first of each, and the one after its last."""
        inside = np.append(np.append(False, self.met & (1 << code) != 0), False)
        edges = np.flatnonzero(inside[1:] != inside[:-1])
        return edges[::2], edges[1::2]


class Means:
    """The mean of each stretch of a sequence; NaN counts as none.

    Attributes
    ----------
    seen : (count,) float array
        How many values came.
    """

    def __init__(self, count: int) -> None:
        self.seen, self._total = np.zeros(count), np.zeros(count)

    def add(self, touched: slice, begins: NDArray[np.intp], values: Floats) -> None:
        """Add a block (B,), as `Stretches.next` has cut it."""
        if not len(values):
            return
        sizes = np.diff(np.append(begins, len(values)))
        total = np.add.reduceat(values, begins)
        if not np.isfinite(total).all():
            known = np.isfinite(values)
            sizes, total = (
                np.add.reduceat(known.astype(np.intp), begins),
                np.add.reduceat(np.where(known, values, 0.0), begins),
            )
        self.seen[touched] += sizes
        self._total[touched] += total

    def result(self) -> Floats:
        """Return the means (count,); NaN where nothing came."""
        means = np.full(len(self.seen), np.nan)
        np.divide(self._total, self.seen, out=means, where=self.seen > 0)
        return means
