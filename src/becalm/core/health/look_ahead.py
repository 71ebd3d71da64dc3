"""Gross outliers of rows that may wait: each is held against readings on both sides."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import BLOCK, Codes, Floats
from becalm.core.health.limits import Limits, stuck_at_once
from becalm.core.health.outliers import plausible
from becalm.native.scans import REACH, scan_outliers


class LookAhead:
    """Holds rows of one channel until three readings after them, or `REACH` rows, have come.

    It returns them in whole blocks, as smoothers take them, and the same for any cut of the record.

    Parameters
    ----------
    limits : Limits
        What the channel keeps to.
    """

    def __init__(self, limits: Limits) -> None:
        self._rule, self._largest, self._stuck = limits.outliers, limits.largest, stuck_at_once(limits)
        self._settings = plausible(self._rule)
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
        waits = self._mark(whole=False) - self._returned
        return self._take(waits // BLOCK * BLOCK)

    def finish(self) -> tuple[Floats, Floats, Codes]:
        """Return the rest, as `push` does."""
        self._mark(whole=True)
        return self._take(len(self._elapsed))

    def _add(self, z: Floats, elapsed: Floats) -> None:
        possible = (np.abs(z) <= self._largest) & (z != self._rule.blank)
        self._z, self._seen = np.append(self._z, z), np.append(self._seen, np.where(possible, z, np.nan))
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
        )

    def _take(self, count: int) -> tuple[Floats, Floats, Codes]:
        rows = slice(self._returned, self._returned + count)
        z, elapsed = self._z[rows], self._elapsed[:count]
        far = self._far[rows].copy()
        kept = max(rows.stop - REACH, 0)
        self._z, self._seen, self._far = self._z[kept:], self._seen[kept:], self._far[kept:]
        self._elapsed, self._returned = self._elapsed[count:], rows.stop - kept
        return z, elapsed, far
