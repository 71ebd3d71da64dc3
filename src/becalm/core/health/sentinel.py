"""Rows of which nothing is told: those whose estimate ran away, and those in holes of which the model knows nothing.

The first is an alarm for faults that nobody has thought of. An estimate is called a runaway where it lies outside of
what is plausible, which is a range of readings beyond both ends of the record that the filter was tuned on, and, for a
sensor that was zeroed since, as far from the last reading that entered as these bounds are apart. A hole begins with
its second row: of one reading that is missing the model knows, where motion is violent, all that can be known. Before
the first row of all none was read.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.core.health.limits import Limits
from becalm.core.rows import EstimatedRows
from becalm.core.verdict import LOST, NOT_READ, Verdict

_NO_ROW = -1


class Sentinel:
    """Removes runaway estimates, and those within long holes, from the output of a filter.

    Parameters
    ----------
    limits : Limits
        What is plausible; of a channel of which nothing is known everything is.
    unknown_from : float
        Sigma from which on a hole is told nothing of, in unit; inf tells of all.
    """

    def __init__(self, limits: Limits, unknown_from: float = np.inf) -> None:
        self._low, self._high, self._unknown_from = limits.outliers.low, limits.outliers.high, unknown_from
        self._read, self._missed, self._waiting = np.nan, True, np.empty(0)

    def push(self, usable: Floats) -> None:
        """Take the readings of rows that will be told, (B,), NaN where none may enter the filter."""
        self._waiting = np.append(self._waiting, usable)

    def told(self, rows: EstimatedRows) -> EstimatedRows:
        """Return rows of which no estimate ran away, and none is unknown."""
        count = len(rows.signal)
        readings, self._waiting = self._waiting[:count], self._waiting[count:]
        if not count:
            return rows
        return self._without_holes(self._without_runaways(rows, readings), NOT_READ[rows.verdicts])

    def _without_runaways(self, told: EstimatedRows, readings: Floats) -> EstimatedRows:
        rows = np.arange(len(readings))
        entered = np.where(LOST[told.verdicts] | np.isnan(readings), _NO_ROW, rows)
        latest = np.maximum.accumulate(entered)
        read = np.where(latest == _NO_ROW, self._read, readings[latest])
        self._read = float(read[-1])
        outside = (told.signal < self._low) | (told.signal > self._high)
        return told.without(outside & (np.abs(told.signal - read) > self._high - self._low), Verdict.RUNAWAY)

    def _without_holes(self, told: EstimatedRows, missing: Booleans) -> EstimatedRows:
        goes_on = missing & np.append(self._missed, missing[:-1])
        self._missed = bool(missing[-1])
        return told.without(goes_on & (told.sigma >= self._unknown_from) & np.isfinite(told.signal), Verdict.HOLE)

    def saved(self) -> dict[str, Floats]:
        """Return what moves, as arrays."""
        return {"sentinel": np.append([self._read, float(self._missed)], self._waiting)}

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Take over what `saved` returned."""
        read, missed = arrays["sentinel"][:2]
        self._read, self._missed, self._waiting = float(read), bool(missed), arrays["sentinel"][2:]
