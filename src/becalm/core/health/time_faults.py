"""What is wrong with the time of rows, told as they come: late, repeated, after a gap.

Time is counted in whole parts of a step, so that sums are exact, and the verdicts those of the whole record wherever it
is cut.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Booleans, Codes, Floats, Integers
from becalm.core.health.limits import Limits
from becalm.core.verdict import Verdict

LONGEST = float(1 << 31)
"""Longest step between two rows that is counted; longer ones are cut to it."""

_TICKS = 1 << 20  # of a step, for what a row is off its time
_LATEST = 0.75  # of a step after it was due: a row that comes later is the next one, and the one due was lost
_REFERENCES = (16, 32, 48)  # rows before, whose median is the even time
_ON_TIME = 0.1  # steps off a whole one: there a row stands in a place of even time, if not its own


def possible_steps(elapsed: Floats) -> Floats:
    """Return steps between rows (B,) as they are counted: one where they are no number, 0 to LONGEST otherwise."""
    if ((elapsed >= 0.0) & (elapsed <= LONGEST)).all():
        return elapsed
    steps: Floats = np.clip(np.nan_to_num(elapsed, nan=1.0), 0.0, LONGEST)
    return steps


class TimeFaults:
    """Watches when rows come, in constant memory.

    Parameters
    ----------
    limits : Limits
        What is a gap, and whether time is even.

    Attributes
    ----------
    offsets : (48,) int64 array
        What moves: of the rows before, in ticks off even time.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.offsets = np.zeros(max(_REFERENCES), dtype=np.int64)

    @property
    def undisturbed(self) -> bool:
        """Whether all rows that are remembered came in even time."""
        return not self.offsets.any()

    def write(self, codes: Codes, elapsed: Floats) -> None:
        """Write into the codes (B,) of the next rows what is wrong with their time, given the steps before them."""
        if self._limits.even:
            codes[self._is_late(elapsed)] = Verdict.LATE
        codes[elapsed > self._limits.gap_steps] = Verdict.GAP
        codes[elapsed == 0] = Verdict.REPEATED

    def _is_late(self, elapsed: Floats) -> Booleans:
        """Tell which rows are off their even time by more than half a step, rows that were lost before left aside.

        Even time goes on from where most of the rows before had it, so that a clock may run a little fast or slow.
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
    """Return the medians of three rows of numbers."""
    least, most = np.minimum(three[0], three[1]), np.maximum(three[0], three[1])
    return np.asarray(np.maximum(least, np.minimum(most, three[2])))
