"""What a filter is given beside readings: step matrices, and sensors."""

from __future__ import annotations

from typing import NamedTuple

from becalm.core.arrays import Floats


class System(NamedTuple):
    """Step matrices of u different lengths, and the sensors."""

    F: Floats  # (u, n, n)
    Q: Floats  # (u, n, n)
    H: Floats  # (m, n)
    R: Floats  # (m, m)
