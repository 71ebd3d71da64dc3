"""The array types of the core, and the one way to keep an array from changing."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]


def frozen(values: ArrayLike) -> Floats:
    """Return our own read-only float64 copy; the caller's array stays as it was."""
    own = np.array(values, dtype=np.float64)
    own.flags.writeable = False
    return own
