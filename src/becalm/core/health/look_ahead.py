"""Gross outliers of rows that may wait: each is held against readings on both sides."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import BLOCK, Codes, Floats
from becalm.core.health.limits import Limits, stuck_at_once
from becalm.core.health.outlier_rule import plausible
from becalm.errors import ModelError
from becalm.native.scans import REACH, SIDE, scan_outliers

_SMOOTHED_BY = 10  # rows of a lag, at the least, where it has them: they are worth more than sooner verdicts


def rows_ahead(lag: int | None) -> int:
    """Return how many rows of a lag, None for all, are waited for to tell outliers; smoothing has the others."""
    if lag is None:
        return REACH
    return min(SIDE, max(lag - _SMOOTHED_BY, 0))


class LookAhead:
    """Holds rows of one channel until those after them have come that tell outliers.

    A smoother's wait for three readings, or `REACH` rows, those of a run until it tells what it is; they are returned
    in whole blocks, as it takes them. Those of a lag wait for so many rows. They are the same for any cut of a record.

    Parameters
    ----------
    limits : Limits
        What the channel keeps to.
    ahead : int
        Rows that each waits for, at the most: `REACH` as for a smoother.
    """

    def __init__(self, limits: Limits, ahead: int = REACH) -> None:
        self._rule, self._largest, self._stuck = limits.outliers, limits.largest, stuck_at_once(limits)
        self._settings, self._ahead = plausible(self._rule), ahead
        self._z = self._seen = np.empty(0)  # the last rows that were returned, and those that wait
        self._far, self._elapsed = np.empty(0, np.int8), np.empty(0)  # of those that wait, the steps before them
        self._returned = 0  # of the rows that are held

    def push(self, z: Floats, elapsed: Floats) -> tuple[Floats, Floats, Codes]:
        """Take readings (B,) and the steps before them.

        Returns
        -------
        (float array, float array, int8 array)
            The next rows, the steps before them, and what is wrong with each reading by those on both sides of it:
            `Verdict.OUTLIER`, `Verdict.STUCK`, or 0.
        """
        self._add(z, elapsed)
        ready = self._mark(whole=False) - self._returned
        return self._take(ready // BLOCK * BLOCK if self._ahead == REACH else ready)

    def finish(self) -> tuple[Floats, Floats, Codes]:
        """Return the rest, as `push` does."""
        self._mark(whole=True)
        return self._take(len(self._elapsed))

    def saved(self) -> dict[str, Any]:
        """Return what later rows depend on, as arrays."""
        waiting = {"ahead_z": self._z, "ahead_elapsed": self._elapsed, "ahead_codes": self._far}
        return waiting | {"ahead_returned": np.array([self._returned])}

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned; raises a ModelError if it is not that of such rows."""
        z, elapsed, codes, told = (np.array(arrays[f"ahead_{name}"]) for name in ("z", "elapsed", "codes", "returned"))
        alike = z.dtype == elapsed.dtype == np.float64 and codes.dtype == np.int8 and told.dtype == np.int64
        if not (alike and told.shape == (1,) and z.shape == codes.shape == (z.size,) and 0 <= told[0] <= REACH):
            raise ModelError("The snapshot's rows that wait are not those of this lag; pass what snapshot() returned.")
        returned = int(told[0])
        if not (elapsed.shape == (z.size - returned,) and (elapsed >= 0).all()):
            raise ModelError("The snapshot's rows that wait go back in time, or are not all there; it is damaged.")
        self._z, self._seen, self._elapsed, self._far = z, self._possible(z), elapsed, codes
        self._returned = returned

    def _possible(self, z: Floats) -> Floats:
        return np.where((np.abs(z) <= self._largest) & (z != self._rule.blank), z, np.nan)

    def _add(self, z: Floats, elapsed: Floats) -> None:
        self._z, self._seen = np.append(self._z, z), np.append(self._seen, self._possible(z))
        self._far, self._elapsed = np.append(self._far, np.zeros(len(z), np.int8)), np.append(self._elapsed, elapsed)

    def _mark(self, *, whole: bool) -> int:
        self._far[self._returned :] = 0
        return scan_outliers(
            self._settings,
            self._seen,
            self._far,
            distance=self._rule.distance,
            stuck=self._stuck,
            begun=self._returned,
            whole=whole,
            ahead=self._ahead,
        )

    def _take(self, count: int) -> tuple[Floats, Floats, Codes]:
        rows = slice(self._returned, self._returned + count)
        z, elapsed = self._z[rows], self._elapsed[:count]
        far = self._far[rows].copy()
        kept = max(rows.stop - REACH, 0)
        self._z, self._seen, self._far = self._z[kept:], self._seen[kept:], self._far[kept:]
        self._elapsed, self._returned = self._elapsed[count:], rows.stop - kept
        return z, elapsed, far
