"""What passes by in blocks, in constant memory: an even choice of it, its mean and its scatter."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats

_MOST_KEPT = 1 << 20
_RUN = 1 << 10


class Thinned:
    """At most about a million of the values that pass by: all, or evenly spread runs of a thousand.

    Parameters
    ----------
    count : int
        How many values will come.
    """

    def __init__(self, count: int) -> None:
        self._period = _RUN * max(1, -(-count // _MOST_KEPT))
        self._at = 0
        self._kept: list[Floats] = []

    def add(self, values: Floats) -> None:
        """Look at the next values."""
        if self._period == _RUN:
            self._kept.append(values.copy())
        else:
            for start in range(-(self._at % self._period), len(values), self._period):
                if start + _RUN > 0:
                    self._kept.append(values[max(0, start) : start + _RUN].copy())
        self._at += len(values)

    @property
    def values(self) -> Floats:
        """What was kept, in order."""
        return np.concatenate(self._kept) if self._kept else np.empty(0)


class Moments:
    """Count, mean and scatter of values and of their products with others, joined block by block (Chan)."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = self.other = self.scatter = self.product = 0.0

    def add(self, values: Floats, others: Floats | None = None) -> None:
        """Join a block in."""
        count, mean = len(values), float(values.mean()) if len(values) else 0.0
        if not count:
            return
        total = self.count + count
        weight, moved = self.count * count / total, mean - self.mean
        centred = values - mean
        if others is not None:
            other = float(others.mean())
            aside = others - other
            shift = other - self.other
            self.product += _dot(centred, aside) + moved * shift * weight
            self.other += shift * count / total
        self.scatter += _dot(centred, centred) + moved * moved * weight
        self.mean += moved * count / total
        self.count = total

    @property
    def std(self) -> float:
        """Standard deviation of all values."""
        return float(np.sqrt(self.scatter / self.count))


def _dot(one: Floats, other: Floats) -> float:
    """Return the product of two vectors, by one thread: those of BLAS wait for each other on a busy machine."""
    return float(np.einsum("i,i", one, other))
