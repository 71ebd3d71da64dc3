"""Whether the innovations keep their size, as one noise level and one sigma demand."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.metrics.running import Running

_BLOCK = 50
_FACTOR = 4.0  # in power: sigma is off by two


class BlockCount(NamedTuple):
    """How many blocks of 50 values there were, and how many of them were uneven."""

    blocks: int = 0
    uneven: int = 0

    def extended(self, piece: Floats) -> BlockCount:
        """Return the count with a piece (n,) of finite values; only the last may end within a block."""
        blocks = len(piece) // _BLOCK
        rows = piece[: blocks * _BLOCK].reshape(blocks, _BLOCK)
        power = np.vecdot(rows, rows) / _BLOCK
        even = int(np.count_nonzero((power >= 1 / _FACTOR) & (power <= _FACTOR)))
        return BlockCount(self.blocks + blocks, self.uneven + blocks - even)

    def share(self) -> float:
        """Return the share of uneven blocks."""
        return self.uneven / self.blocks if self.blocks else 0.0


class RunningEvenness(Running[BlockCount]):
    """The uneven share of a sequence that comes in blocks of any length."""

    def __init__(self) -> None:
        super().__init__(BlockCount(), BlockCount.extended)

    def result(self) -> float:
        """Return `uneven_share` of all values so far; more may follow."""
        return self.sums().share()


def uneven_share(normalised: Floats) -> float:
    """Return the share of blocks of 50 whose mean power is off by more than a factor of four.

    Parameters
    ----------
    normalised : (N,) float array
        Innovations over their expected standard deviation; NaN is left out.

    Notes
    -----
    The mean power of 50 white Gaussian innovations is 1 with a standard deviation of 0.2, so that
    chance alone gives none. A large share says that sigma holds on average only.
    """
    running = RunningEvenness()
    running.add(normalised)
    return running.result()
