"""Statistics of values that come in blocks, in constant memory: a thinned copy, mean and scatter."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats

_MOST_KEPT = 1 << 20
_RUN = 1 << 10


class Thinned:
    """Keeps at most about a million of the values added: all of them, or evenly spread runs of a thousand.

    Parameters
    ----------
    count : int
        Number of values that will be added.
    """

    def __init__(self, count: int) -> None:
        self._period = _RUN * max(1, -(-count // _MOST_KEPT))
        self._at = 0
        self._kept: list[Floats] = []

    def add(self, values: Floats) -> None:
        """Add the next values."""
        if self._period == _RUN:
            self._kept.append(values.copy())
        else:
            for start in range(-(self._at % self._period), len(values), self._period):
                if start + _RUN > 0:
                    self._kept.append(values[max(0, start) : start + _RUN].copy())
        self._at += len(values)

    @property
    def values(self) -> Floats:
        """Return the values kept, in order."""
        return np.concatenate(self._kept) if self._kept else np.empty(0)


class Moments:
    """Count, mean and scatter of values and of their products with others, updated by blocks (Chan)."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = self.other = self.scatter = self.product = 0.0

    def add(self, values: Floats, others: Floats | None = None) -> None:
        """Add a block."""
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
        """Return the standard deviation of all values."""
        return float(np.sqrt(self.scatter / self.count))


def _dot(one: Floats, other: Floats) -> float:
    """Return the dot product, computed in one thread: BLAS threads wait for each other on a busy machine."""
    return float(np.einsum("i,i", one, other))
