"""Remove runaway estimates, and estimates within long holes, from the output of a filter.

In a causal channel `native/sensor.h` does this row by row.

A runaway indicates a fault of the filter or of its recipe. An estimate is a runaway if it lies outside the plausible
bounds and its distance from the last used reading is larger than the distance between the bounds. The bounds are those
of the record on which the filter was tuned, extended by its range on both sides. The second condition allows for a
sensor that was zeroed after the tuning.

A hole begins at the second of two consecutive missing rows. The estimate of the first missing row is always kept: a
large sigma there may only mean violent motion. The rows before the first reading count as missing.
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
        Limits with the plausible bounds; with infinite bounds, the default, every estimate is plausible.
    hole_sigma : float
        Estimates within a hole are removed if sigma is at least this, in unit; with inf none are removed.
    """

    def __init__(self, limits: Limits, hole_sigma: float = np.inf) -> None:
        self._low, self._high, self._hole_sigma = limits.outliers.low, limits.outliers.high, hole_sigma
        self._last_used, self._missed, self._waiting = np.nan, True, np.empty(0)

    def push(self, usable: Floats) -> None:
        """Take the readings (B,) of the next rows, before their estimates; NaN where a reading was left out."""
        self._waiting = np.append(self._waiting, usable)

    def mark_implausible(self, rows: EstimatedRows) -> EstimatedRows:
        """Return the rows with NaN in place of runaways and of uncertain estimates in holes, and with new verdicts."""
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
        return rows.without(in_hole & (rows.sigma >= self._hole_sigma) & np.isfinite(rows.signal), Verdict.HOLE)

    def state_dict(self) -> dict[str, Floats]:
        """Return the state, as arrays."""
        return {"sentinel": np.append([self._last_used, float(self._missed)], self._waiting)}

    def load_state_dict(self, arrays: Mapping[str, Floats]) -> None:
        """Restore the result of `state_dict`."""
        last_used, missed = arrays["sentinel"][:2]
        self._last_used, self._missed, self._waiting = float(last_used), bool(missed), arrays["sentinel"][2:]
