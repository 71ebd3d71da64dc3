"""Collect named numbers message by message in columns of the smallest suitable type."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

_FLAG, _WHOLE, _REAL = "b", "q", "d"  # type codes of arrays
_MOST = 4096  # most columns
_SPARSE, _ALWAYS = 64, 1 << 20  # missing cells that are allowed: for each present cell, and in addition for any table
_LEAST_WHOLE, _MOST_WHOLE = -(1 << 63), (1 << 63) - 1


class Series:
    """A collector of columns of equal length; a number that a message lacks is NaN.

    Attributes
    ----------
    count : int
        Number of messages.
    full : bool
        Whether numbers were dropped to limit the memory: there are too many names, or too many missing cells.
    """

    def __init__(self) -> None:
        self._columns: dict[str, array[Any]] = {}
        self.count = 0
        self._spare = _ALWAYS
        self.full = False

    def add(self, message: Iterable[tuple[str, float]]) -> None:
        """Add the numbers of one message, with their names; a flag is a bool."""
        for name, value in message:
            column = self._columns.get(name)
            kind = _kind(value)
            if column is None:
                if len(self._columns) >= _MOST:
                    self.full = True
                    continue
                column = self._columns[name] = array(_REAL if self.count else kind)
            missed = self.count - len(column)
            if missed < 0 or not self._may_miss(missed):  # missed < 0: the message has the name twice
                continue
            if column.typecode != _REAL and (missed or kind != column.typecode):
                column = self._columns[name] = array(_REAL, column)
            if missed:
                column.extend(array(_REAL, [np.nan]) * missed)
            column.append(value)
            self._spare += _SPARSE
        self.count += 1

    def _may_miss(self, cells: int) -> bool:
        if cells > self._spare:
            self.full = True
            return False
        self._spare -= cells
        return True

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns, each (count,), in the order of their first appearance."""
        out: dict[str, NDArray[Any]] = {}
        for name, column in self._columns.items():
            missed = self.count - len(column)
            if not self._may_miss(missed):
                continue
            values = np.array(column)
            if missed:
                values = np.concatenate([values, np.full(missed, np.nan)])
            out[name] = values.astype(np.bool_) if values.dtype == np.int8 else values
        return out


def _kind(value: float) -> str:
    if isinstance(value, bool):
        return _FLAG
    return _WHOLE if isinstance(value, int) and _LEAST_WHOLE <= value <= _MOST_WHOLE else _REAL
