"""Sums over a sequence of any length that comes in blocks, in constant memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np

from becalm.core.arrays import Floats

PIECE = 8000
"""Values per piece, a multiple of 50: a piece fits into the cache, and BLAS uses one thread for it."""

Sums = TypeVar("Sums")


class Running(Generic[Sums]):
    """Sums over the finite values of a sequence that comes in blocks of any length.

    The finite values are split into pieces of `PIECE`, counted from the first finite value; so the sums
    depend neither on the borders of the blocks nor on missing values.

    Parameters
    ----------
    nothing : Sums
        The sums of no values.
    extended : callable
        Takes sums and a piece (up to `PIECE`,), and returns the sums with the piece added. Only the last
        piece is shorter. The array of the piece is reused afterwards.
    """

    def __init__(self, nothing: Sums, extended: Callable[[Sums, Floats], Sums]) -> None:
        self._sums = nothing
        self._extended = extended
        self._rest = np.empty(PIECE)  # buffer for an incomplete piece
        self._held = 0  # values in the buffer

    def add(self, values: Floats) -> None:
        """Add a block (B,); NaN and inf are left out."""
        with np.errstate(over="ignore", invalid="ignore"):
            for start in range(0, len(values), PIECE):
                part = values[start : start + PIECE]
                finite = np.isfinite(part)
                self._take(part if finite.all() else part[finite])

    def sums(self) -> Sums:
        """Return the sums of all values so far; more may follow."""
        if not self._held:
            return self._sums
        with np.errstate(over="ignore", invalid="ignore"):
            return self._extended(self._sums, self._rest[: self._held])

    def _take(self, part: Floats) -> None:
        """Add at most one piece of finite values; a whole piece is not copied if the buffer is empty."""
        if len(part) == PIECE and not self._held:
            self._sums = self._extended(self._sums, part)
            return
        fitting, excess = part[: PIECE - self._held], part[PIECE - self._held :]
        self._rest[self._held : self._held + len(fitting)] = fitting
        self._held += len(fitting)
        if self._held == PIECE:
            self._sums = self._extended(self._sums, self._rest)
            self._rest[: len(excess)] = excess
            self._held = len(excess)
