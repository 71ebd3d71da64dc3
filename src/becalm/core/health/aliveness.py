"""Check that a sensor is surely alive: no window of its innovations is as quiet as that of a dead one.

A monitor tests windows of whole hops, and where hops begin depends on all innovations before. Any 64 innovations in a
row include three whole hops, 48 innovations. Their sum of squares about their own mean is at most that of the window.
So if it is above the threshold for every three hops, no window can be dead, wherever the hops begin.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Integers
from becalm.native.scans import HOP, PARTS, WINDOW

_WHOLE = WINDOW // HOP - 1
"""Whole hops within any window."""


class Aliveness:
    """A check that no window of a channel's innovations can have been that of a dead sensor.

    Parameters
    ----------
    dead_variance : float
        Variance of a window, in sigma^2, below which the sensor counts as dead.

    Attributes
    ----------
    sure : bool
        Whether no window so far can have been that of a dead sensor, wherever hops begin.
    """

    def __init__(self, dead_variance: float) -> None:
        self._least, self.sure = dead_variance * (WINDOW - 1) * PARTS**2, True

    def add(self, sums: Integers) -> None:
        """Take the sums and the sums of squares of hops in a row, (2, H): the last three known ones, then new ones."""
        count = sums.shape[1] - _WHOLE + 1
        if count > 0 and self._least > 0.0 and self.sure:
            total, squares = np.sum([sums[:, k : k + count] for k in range(_WHOLE)], axis=0)
            self.sure = bool(np.all(squares - total / (_WHOLE * HOP) * total > self._least))
