"""Test whether the variance of the innovations is constant, as a model with one noise level assumes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.metrics.running import Running

_BLOCK = 50
_FACTOR = 4.0  # in power: a factor of two in sigma


class BlockCount(NamedTuple):
    """Number of blocks of 50 values, and number of uneven blocks."""

    blocks: int = 0
    uneven: int = 0

    def extended(self, piece: Floats) -> BlockCount:
        """Return the count with a piece (n,) of finite values added; only the last piece may end within a block."""
        blocks = len(piece) // _BLOCK
        rows = piece[: blocks * _BLOCK].reshape(blocks, _BLOCK)
        power = np.vecdot(rows, rows) / _BLOCK
        even = int(np.count_nonzero((power >= 1 / _FACTOR) & (power <= _FACTOR)))
        return BlockCount(self.blocks + blocks, self.uneven + blocks - even)

    def share(self) -> float:
        """Return the share of uneven blocks."""
        return self.uneven / self.blocks if self.blocks else 0.0


class RunningEvenness(Running[BlockCount]):
    """Computes the uneven share of a sequence that comes in blocks of any length."""

    def __init__(self) -> None:
        super().__init__(BlockCount(), BlockCount.extended)

    def result(self) -> float:
        """Return the `uneven_share` of all values so far; more may follow."""
        return self.sums().share()


def uneven_share(normalised: Floats) -> float:
    """Return the share of blocks of 50 values whose mean power differs from 1 by more than a factor of four.

    Parameters
    ----------
    normalised : (N,) float array
        Innovations over their expected standard deviation; NaN is left out.

    Notes
    -----
    The mean power of 50 white Gaussian innovations is 1 with a standard deviation of 0.2, so chance
    gives no uneven blocks. A large share means that sigma is correct only on average.
    """
    running = RunningEvenness()
    running.add(normalised)
    return running.result()
