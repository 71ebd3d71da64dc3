"""Whether scores are as large as standard normal numbers: how much of their probability is elsewhere.

A filter with several modes foretells a mixture, and in the score of a reading (its normal quantile) no error is
large: far out, some mode expected it. So the whole distribution is looked at, and not its power.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats

_EDGES = 0.1 * np.arange(1, 40)


class ScoreCount(NamedTuple):
    """How many scores were smaller, in magnitude, than each of the edges; and how many there were."""

    below: Floats = np.zeros(len(_EDGES))
    seen: int = 0

    def extended(self, piece: Floats) -> ScoreCount:
        """Return the count with a piece (n,) of finite values."""
        return ScoreCount(self.below + np.searchsorted(np.sort(np.abs(piece)), _EDGES), self.seen + len(piece))

    def share(self) -> float:
        """Return the share of probability that is misplaced; 0.16 where every score is 1.4 times too large."""
        from scipy.special import ndtr

        if not self.seen:
            return 0.0
        return float(np.abs(self.below / self.seen - (2 * ndtr(_EDGES) - 1)).max())
