"""Buffer the raw rows of a stream until a fixed-lag filter returns their estimates."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import ModelError


class DelayedRows:
    """A buffer of the rows that were passed to a fixed-lag filter and whose estimates are not ready yet.

    `returned` is the number of rows at the front that `Stream.finish` has already returned with estimates, if the
    stream continues after it.

    Parameters
    ----------
    width : int
        Number of channels.
    """

    def __init__(self, width: int) -> None:
        self.time_s, self.values = np.empty(0), np.empty((0, width))
        self.returned = 0

    @property
    def count(self) -> int:
        """Return the number of buffered rows."""
        return len(self.time_s)

    def rows(self, first: int) -> tuple[Floats, Floats]:
        """Return stamps and readings of the buffered rows from row `first` on; they stay in the buffer."""
        return self.time_s[first:], self.values[first:]

    def push_and_pop(self, time_s: Floats, values: Floats, ready: int) -> tuple[Floats, Floats, int]:
        """Add rows at the end and remove `ready` rows from the front.

        Returns
        -------
        tuple
            Stamps (n,) and readings (n, m) of the removed rows that were not returned before, and the number of removed
            rows that were returned before.
        """
        time_s, values = np.concatenate([self.time_s, time_s]), np.concatenate([self.values, values])
        self.time_s, self.values = time_s[ready:].copy(), values[ready:].copy()
        returned_before = min(self.returned, ready)
        self.returned -= returned_before
        return time_s[returned_before:ready], values[returned_before:ready], returned_before

    def restore(self, time_s: Floats, values: Floats, returned: int) -> None:
        """Restore the buffer of a stopped stream; raise a ModelError if the shapes of the arrays do not match."""
        if values.shape != (len(time_s), self.values.shape[1]) or not 0 <= returned <= len(time_s):
            raise ModelError("The stream's snapshot is damaged; start a new stream in another folder.")
        self.time_s, self.values, self.returned = time_s, values, returned
