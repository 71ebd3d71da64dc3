"""The autocovariance of a sequence that comes in pieces, exact across their borders."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, frozen

MOST_LAGS = 32
_ROW = 8  # shortest row for which BLAS is fast
_SHIFTS = MOST_LAGS // _ROW + 1


class LaggedSums(NamedTuple):
    """Sums over a sequence e, and over its products with the values up to 32 places earlier.

    Attributes
    ----------
    seen : int
        Number of values so far.
    shift : float
        Mean of the first piece; the sums are over c = e - shift.
    total : float
        Sum of c.
    products : (5, 8, 8) float array
        Sums of products of c with c up to 32 values earlier, both in rows of 8; see `about_mean`.
    head, tail : (32,) float array
        The first and the last 32 values of c; zero if there are fewer.
    varies : bool
        True if not all c are equal.

    Notes
    -----
    The shift loses no accuracy: n var = sum (e - mean)^2 >= P (shift - mean)^2 for a first piece of
    P values, so rounding errors grow at most by the factor n/P for any mean.
    """

    seen: int = 0
    shift: float = 0.0
    total: float = 0.0
    products: Floats = frozen(np.zeros((_SHIFTS, _ROW, _ROW)))
    head: Floats = frozen(np.zeros(MOST_LAGS))
    tail: Floats = frozen(np.zeros(MOST_LAGS))
    varies: bool = False

    def extended(self, piece: Floats) -> LaggedSums:
        """Return the sums with a piece (n,) of finite values added; the first piece must be long or the only one."""
        n = len(piece)
        shift = self.shift if self.seen else float(np.mean(piece))
        rows = -(-n // _ROW)
        own = np.zeros(rows * _ROW)
        np.subtract(piece, shift, out=own[:n])
        c = np.append(self.tail, own)  # a copy, because BLAS is slower for the product of an array with itself
        step = c.itemsize
        earlier = np.ndarray((_SHIFTS, rows, _ROW), float, c, strides=(_ROW * step, _ROW * step, step))
        head = self.head if self.seen else np.append(own[:MOST_LAGS], np.zeros(MOST_LAGS))[:MOST_LAGS]
        return LaggedSums(
            self.seen + n,
            shift,
            self.total + float(own.sum()),
            self.products + own.reshape(rows, _ROW).T @ earlier,
            head,
            c[n : n + MOST_LAGS].copy(),
            self.varies or bool(np.any(own[:n] != head[0])),
        )

    def about_mean(self, lags: int) -> Floats:
        """Return the sum of (e[i] - mean) (e[i - j] - mean) over i, for j = 0 to `lags`, up to 32."""
        # products[k, a, b] sums c[i] c[i - j] over every eighth i, with j = 32 + a - 8 k - b
        by_row = self.products.transpose(1, 0, 2).reshape(_ROW, _SHIFTS * _ROW)
        diagonals = np.array([by_row[a, a : a + MOST_LAGS + 1] for a in range(_ROW)])
        j = np.arange(lags + 1)
        first = np.append(0.0, np.cumsum(self.head))[: lags + 1]
        last = np.append(0.0, np.cumsum(self.tail[::-1]))[: lags + 1]
        mean = self.total / self.seen
        with np.errstate(over="ignore", invalid="ignore"):  # squares that overflow give inf or NaN
            lagged = diagonals.sum(axis=0)[::-1][: lags + 1]
            about: Floats = lagged - mean * (2 * self.total - first - last) + (self.seen - j) * mean * mean
        return about
