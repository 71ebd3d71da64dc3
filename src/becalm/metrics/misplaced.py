"""Compare the distribution of scores with the standard normal one: which share of probability is misplaced.

An IMM predicts a mixture. The score of a reading is its normal quantile under the mixture, and it is never large,
because one of the modes expects even distant readings. The test therefore uses the whole distribution, not the power.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats

_EDGES = 0.1 * np.arange(1, 40)


class ScoreCount(NamedTuple):
    """Number of scores with a magnitude below each edge, and number of all scores."""

    below: Floats = np.zeros(len(_EDGES))
    seen: int = 0

    def extended(self, piece: Floats) -> ScoreCount:
        """Return the count with a piece (n,) of finite values added."""
        return ScoreCount(self.below + np.searchsorted(np.sort(np.abs(piece)), _EDGES), self.seen + len(piece))

    def share(self) -> float:
        """Return the misplaced share of probability; it is 0.16 if every score is 1.4 times too large."""
        from scipy.special import ndtr

        if not self.seen:
            return 0.0
        return float(np.abs(self.below / self.seen - (2 * ndtr(_EDGES) - 1)).max())
