"""The matrices that a filter needs: those of its steps and those of its sensors."""

from __future__ import annotations

from typing import NamedTuple

from becalm.core.arrays import Floats


class System(NamedTuple):
    """Matrices F and Q of steps of u different lengths, and H and R of the sensors."""

    F: Floats  # (u, n, n)
    Q: Floats  # (u, n, n)
    H: Floats  # (m, n)
    R: Floats  # (m, m)
