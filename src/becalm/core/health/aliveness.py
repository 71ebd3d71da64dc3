"""Whether a channel is surely alive: no window of its innovations is as quiet as that of a dead one.

A monitor looks at windows that begin with every hop, and where hops begin depends on all innovations before. Any window
of 64 in a row holds three whole hops, 48 of them, whose squares about their own mean are no more than those of the
window: while these are louder than that, hops may begin wherever they like.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Integers
from becalm.native.scans import HOP, PARTS, WINDOW

_WHOLE = WINDOW // HOP - 1
"""Hops that any window holds."""


class Aliveness:
    """Checks that no window of a channel's innovations can have been one of a dead sensor.

    Parameters
    ----------
    dead_variance : float
        Of a window that is dead, in sigma^2.

    Attributes
    ----------
    sure : bool
        Whether no window so far can have been one of a dead channel, wherever hops begin.
    """

    def __init__(self, dead_variance: float) -> None:
        self._least, self.sure = dead_variance * (WINDOW - 1) * PARTS**2, True

    def add(self, sums: Integers) -> None:
        """Take the sums, and the sums of squares, of hops in a row (2, H): the last three of before, then new ones."""
        count = sums.shape[1] - _WHOLE + 1
        if count > 0 and self._least > 0.0 and self.sure:
            total, squares = np.sum([sums[:, k : k + count] for k in range(_WHOLE)], axis=0)
            self.sure = bool(np.all(squares - total / (_WHOLE * HOP) * total > self._least))
