"""Remove estimates that ran away, and estimates within long holes, from the output of a filter.

In a causal channel `native/sensor.h` does the same, row by row.

A runaway is an alarm for unexpected faults. An estimate is a runaway if it lies outside the plausible bounds and is
farther from the last used reading than these bounds are apart. The bounds are those of the record that the filter was
tuned on, extended by its range on both sides; the second condition allows for a sensor that was zeroed since.

A hole begins with the second missing row: during violent motion sigma may be large after a single missing reading, but
no better estimate of that row is possible. The rows before the first reading also count as missing.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.core.health.limits import Limits
from becalm.core.reading_verdicts import LOST, NOT_READ, Verdict
from becalm.core.rows import EstimatedRows

_NO_ROW = -1  # in place of a row, if there is none


class Sentinel:
    """A filter's last stage, which removes runaway estimates and those within long holes.

    Parameters
    ----------
    limits : Limits
        They hold the plausible bounds; infinite bounds, the default, make every estimate plausible.
    unknown_from : float
        Sigma from which on estimates within a hole are removed, in unit; inf keeps all.
    """

    def __init__(self, limits: Limits, unknown_from: float = np.inf) -> None:
        self._low, self._high, self._unknown_from = limits.outliers.low, limits.outliers.high, unknown_from
        self._last_used, self._missed, self._waiting = np.nan, True, np.empty(0)

    def push(self, usable: Floats) -> None:
        """Take the readings (B,) of the next rows, NaN where none may enter the filter, before their estimates."""
        self._waiting = np.append(self._waiting, usable)

    def mark_implausible(self, rows: EstimatedRows) -> EstimatedRows:
        """Return the rows with NaN in place of runaways and of unknown estimates in holes, and with their verdicts."""
        count = len(rows.signal)
        readings, self._waiting = self._waiting[:count], self._waiting[count:]
        if not count:
            return rows
        return self._without_holes(self._without_runaways(rows, readings), NOT_READ[rows.verdicts])

    def _without_runaways(self, rows: EstimatedRows, readings: Floats) -> EstimatedRows:
        used_rows = np.where(LOST[rows.verdicts] | np.isnan(readings), _NO_ROW, np.arange(len(readings)))
        latest = np.maximum.accumulate(used_rows)
        last_used = np.where(latest == _NO_ROW, self._last_used, readings[latest])
        self._last_used = float(last_used[-1])
        outside = (rows.signal < self._low) | (rows.signal > self._high)
        return rows.without(outside & (np.abs(rows.signal - last_used) > self._high - self._low), Verdict.RUNAWAY)

    def _without_holes(self, rows: EstimatedRows, missing: Booleans) -> EstimatedRows:
        in_hole = missing & np.append(self._missed, missing[:-1])
        self._missed = bool(missing[-1])
        return rows.without(in_hole & (rows.sigma >= self._unknown_from) & np.isfinite(rows.signal), Verdict.HOLE)

    def saved(self) -> dict[str, Floats]:
        """Return the state, as arrays."""
        return {"sentinel": np.append([self._last_used, float(self._missed)], self._waiting)}

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Restore the result of `saved`."""
        last_used, missed = arrays["sentinel"][:2]
        self._last_used, self._missed, self._waiting = float(last_used), bool(missed), arrays["sentinel"][2:]
