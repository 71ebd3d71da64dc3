"""The array types of the core, and the one way to keep an array from changing."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Number = TypeVar("Number", np.float64, np.int64)
Booleans = NDArray[np.bool_]
Codes = NDArray[np.int8]
Complexes = NDArray[np.complex128]

BLOCK = 256
"""Rows a block, at whose multiples a run over a part of a record has to begin."""


def real(values: ArrayLike) -> ArrayLike:
    """Return values as they came, if they are real numbers; of a masked array NaN where it is masked.

    Raises
    ------
    TypeError
        If they are complex, text or dates, which float64 would silently change.
    """
    kind = np.asarray(values).dtype.kind
    if kind in "cSUMm":
        raise TypeError(f"real numbers are needed, {np.asarray(values).dtype} came")
    return np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan) if np.ma.isMaskedArray(values) else values


def read_only(values: NDArray[Number]) -> NDArray[Number]:
    """Return a read-only view."""
    view = values.view()
    view.flags.writeable = False
    return view


def input_of(values: Floats) -> Floats:
    """Return the one kind of array that filters take from anywhere: float64, contiguous, read-only."""
    return read_only(np.ascontiguousarray(values, dtype=np.float64))


def block_diagonal(first: Floats, second: Floats) -> Floats:
    """Return a matrix of two blocks, (k, l) and (m, n), with zeros beside them, (k + m, l + n)."""
    (rows, columns), joined = first.shape, np.zeros(np.add(first.shape, second.shape))
    joined[:rows, :columns], joined[rows:, columns:] = first, second
    return joined


def frozen(values: ArrayLike) -> Floats:
    """Return our own read-only float64 copy; the caller's array stays as it was."""
    own = np.array(values, dtype=np.float64, order="C")
    own.flags.writeable = False
    return own
