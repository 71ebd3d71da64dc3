"""What became of each reading: every outcome is a value, with advice."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers

BEYOND_ANY_SENSOR = 1e100
"""A magnitude whose square would leave float64; no sensor reads it."""


class Verdict(IntEnum):
    """What became of one reading."""

    USED = 0
    MISSING = 1
    NONFINITE = 2
    OVERRANGE = 3


ADVICE = {
    Verdict.MISSING: "Missing readings are predicted across; sigma grows there.",
    Verdict.NONFINITE: "Infinite readings were treated as missing; look at the sensor or at its conversion.",
    Verdict.OVERRANGE: "Readings beyond 1e100 were treated as missing; look at the file.",
}


class Judged(NamedTuple):
    """Readings that may enter a filter, and the verdict on each."""

    readings: Floats  # (N,) NaN where not used
    verdicts: Integers  # (N,)

    def counts(self) -> dict[str, int]:
        """Count each verdict by its name."""
        return {verdict.name.lower(): int((self.verdicts == verdict).sum()) for verdict in Verdict}


def judge(z: Floats) -> Judged:
    """Let only finite, possible readings of one channel (N,) through."""
    verdicts = np.full(z.shape, int(Verdict.USED), dtype=np.int64)
    with np.errstate(invalid="ignore"):
        verdicts[np.abs(z) > BEYOND_ANY_SENSOR] = Verdict.OVERRANGE
    verdicts[np.isinf(z)] = Verdict.NONFINITE
    verdicts[np.isnan(z)] = Verdict.MISSING
    return Judged(np.where(verdicts == Verdict.USED, z, np.nan), verdicts)
