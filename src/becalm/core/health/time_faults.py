"""Detect faults of the rows' times as rows arrive: late, repeated, after a gap.

Time is counted in whole parts of a step, so that sums are exact: the cuts between blocks do not change the verdicts.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Booleans, Codes, Floats, Integers
from becalm.core.health.limits import Limits
from becalm.core.verdict import Verdict

LONGEST = float(1 << 31)
"""Longest step between two rows; longer ones are reduced to it."""

_TICKS = 1 << 20  # ticks in a step; deviations from even time are counted in them
_LATEST = 0.75  # of a step: a row that is later than this is the next one, and the expected one was lost
_REFERENCES = (16, 32, 48)  # rows before; the median of their deviations is the even time
_ON_TIME = 0.1  # steps: a row this close to a whole number of steps off has the time of another row; it is not late


def possible_steps(elapsed: Floats) -> Floats:
    """Return the steps between rows (B,) with possible values: 1 in place of NaN, otherwise from 0 to LONGEST."""
    if ((elapsed >= 0.0) & (elapsed <= LONGEST)).all():
        return elapsed
    steps: Floats = np.clip(np.nan_to_num(elapsed, nan=1.0), 0.0, LONGEST)
    return steps


class TimeFaults:
    """A detector of faults in the times of rows, in constant memory.

    Parameters
    ----------
    limits : Limits
        They define a gap, and whether time is even.

    Attributes
    ----------
    offsets : (48,) int64 array
        The state: deviations of the last rows from even time, in ticks.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.offsets = np.zeros(max(_REFERENCES), dtype=np.int64)

    @property
    def undisturbed(self) -> bool:
        """Whether none of the last rows deviates from even time."""
        return not self.offsets.any()

    def write(self, codes: Codes, elapsed: Floats) -> None:
        """Write verdicts on the times of the next rows into `codes` (B,); `elapsed` (B,) are the steps before them."""
        if self._limits.even:
            codes[self._is_late(elapsed)] = Verdict.LATE
        codes[elapsed > self._limits.gap_steps] = Verdict.GAP
        codes[elapsed == 0] = Verdict.REPEATED

    def _is_late(self, elapsed: Floats) -> Booleans:
        """Return which rows deviate from even time by more than half a step; lost rows before them do not count.

        Even time follows the median of earlier rows, so that a clock may run a little fast or slow.
        """
        due = np.where(elapsed > self._limits.gap_steps, np.ceil(elapsed - _LATEST), 1.0)
        off = np.where(elapsed > 0, elapsed - due, 0.0)
        moved = np.cumsum(np.rint(off * _TICKS).astype(np.int64))
        offsets = np.append(self.offsets, self.offsets[-1] + moved)
        ahead = len(self.offsets)
        even = _middle([offsets[ahead - rows : len(offsets) - rows] for rows in _REFERENCES])
        late = (offsets[ahead:] - even) / _TICKS
        self.offsets = offsets[-ahead:].copy()
        return np.asarray((np.abs(late) > 0.5) & (np.abs(late - np.round(late)) > _ON_TIME))


def _middle(three: list[Integers]) -> Integers:
    """Return the elementwise medians of three arrays."""
    least, most = np.minimum(three[0], three[1]), np.maximum(three[0], three[1])
    return np.asarray(np.maximum(least, np.minimum(most, three[2])))
