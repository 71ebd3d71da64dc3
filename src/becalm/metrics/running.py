"""Sums over a sequence of any length that comes in blocks, in constant memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np

from becalm.core.arrays import Floats

PIECE = 8000
"""Values summed at once: they stay in the cache, and BLAS starts no threads for so few. Divides into blocks of 50."""

Sums = TypeVar("Sums")


class Running(Generic[Sums]):
    """Sums over the finite values of a sequence that comes in blocks of any length.

    The finite values are cut into pieces of `PIECE`, counted from the first of them; so the sums
    do not depend on where the blocks end or on what was missing between.

    Parameters
    ----------
    nothing : Sums
        The sums of no values.
    extended : callable
        Takes sums and a piece (up to `PIECE`,), and returns the sums with that piece. Only the last
        piece is shorter; a piece must not be kept.
    """

    def __init__(self, nothing: Sums, extended: Callable[[Sums, Floats], Sums]) -> None:
        self._sums = nothing
        self._extended = extended
        self._rest = np.empty(PIECE)
        self._held = 0  # of the rest: values that do not fill a piece yet

    def add(self, values: Floats) -> None:
        """Add a block (B,); NaN and inf are left out."""
        with np.errstate(over="ignore", invalid="ignore"):
            for start in range(0, len(values), PIECE):
                part = values[start : start + PIECE]
                known = np.isfinite(part)
                self._take(part if known.all() else part[known])

    def sums(self) -> Sums:
        """Return the sums of all values so far; more may follow."""
        if not self._held:
            return self._sums
        with np.errstate(over="ignore", invalid="ignore"):
            return self._extended(self._sums, self._rest[: self._held])

    def _take(self, part: Floats) -> None:
        """Take up to a piece of finite values; a whole one that meets no rest is not copied."""
        if len(part) == PIECE and not self._held:
            self._sums = self._extended(self._sums, part)
            return
        fitting, left = part[: PIECE - self._held], part[PIECE - self._held :]
        self._rest[self._held : self._held + len(fitting)] = fitting
        self._held += len(fitting)
        if self._held == PIECE:
            self._sums = self._extended(self._sums, self._rest)
            self._rest[: len(left)] = left
            self._held = len(left)
