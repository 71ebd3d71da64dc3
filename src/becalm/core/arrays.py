"""Array types of the core, and functions that make arrays read-only."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Number = TypeVar("Number", np.float64, np.int64)
Booleans = NDArray[np.bool_]
Codes = NDArray[np.int8]  # values of `Verdict`
Complexes = NDArray[np.complex128]

BLOCK = 256
"""Rows per block. A run over a part of a record gives the bits of a run over the whole record if the part begins at a
multiple of this number."""


def real(values: ArrayLike) -> ArrayLike:
    """Return the values unchanged if they are real numbers; fill masked entries of a masked array with NaN.

    Raises
    ------
    TypeError
        If the values are complex, text or dates, because a conversion to float64 would change them silently.
    ValueError
        If a whole number is beyond the range of float64.
    """
    if isinstance(values, list | tuple) and any(isinstance(row, np.ma.MaskedArray) for row in values):
        values = np.ma.array(values)
    kind = np.asarray(values).dtype.kind
    if kind in "cSUMm":
        raise TypeError(f"real numbers are needed, {np.asarray(values).dtype} came")
    if kind == "O":
        try:
            values = np.asarray(values, dtype=np.float64)
        except OverflowError as cause:
            raise ValueError(str(cause)) from cause
    return np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan) if np.ma.isMaskedArray(values) else values


def read_only(values: NDArray[Number]) -> NDArray[Number]:
    """Return a read-only view."""
    view = values.view()
    view.flags.writeable = False
    return view


def input_of(values: Floats) -> Floats:
    """Return the values as a contiguous, read-only float64 array, the type that all filters take."""
    return read_only(np.ascontiguousarray(values, dtype=np.float64))


def block_diagonal(first: Floats, second: Floats) -> Floats:
    """Return the block-diagonal matrix (k + m, l + n) of two blocks, (k, l) and (m, n)."""
    (rows, columns), joined = first.shape, np.zeros(np.add(first.shape, second.shape))
    joined[:rows, :columns], joined[rows:, columns:] = first, second
    return joined


def frozen(values: ArrayLike) -> Floats:
    """Return a read-only float64 copy; the caller's array does not change."""
    own = np.array(values, dtype=np.float64, order="C")
    own.flags.writeable = False
    return own
