"""What kernels are given: step matrices, sensors, and the readings of a record."""

from __future__ import annotations

from typing import NamedTuple

from becalm.core.arrays import Floats, Integers


class System(NamedTuple):
    """Step matrices of u different lengths, and the sensors."""

    F: Floats  # (u, n, n)
    Q: Floats  # (u, n, n)
    H: Floats  # (m, n)
    R: Floats  # (m, m)


class Step(NamedTuple):
    """One step, and the sensors that read after it."""

    F: Floats  # (n, n)
    Q: Floats  # (n, n)
    H: Floats  # (m, n)
    R: Floats  # (m, m)


class Record(NamedTuple):
    """Readings, and the steps before them: rows first[s] to first[s + 1] - 1 follow step[s] each."""

    z: Floats  # (N, m)
    first: Integers  # (runs + 1,)
    step: Integers  # (runs,) which matrices of the System; -1: no step
