"""Detect gross outliers with a delay: compare each reading with its neighbours on both sides."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import BLOCK, Codes, Floats
from becalm.core.health.limits import Limits, stuck_at_once
from becalm.core.health.outlier_rule import packed_rule
from becalm.errors import ModelError
from becalm.native.scans import REACH, SIDE, scan_outliers

_SMOOTHED_BY = 10  # first rows of a lag: only the smoother uses them, because they help there more than in the test


def rows_ahead(lag: int | None) -> int:
    """Return for how many of the `lag` rows the outlier test may wait; lag None, a smoother, gives `REACH`."""
    if lag is None:
        return REACH
    return min(SIDE, max(lag - _SMOOTHED_BY, 0))


class LookAhead:
    """A buffer that holds the rows of one channel until it has the later rows that the outlier test needs.

    For a smoother, a row waits for three readings or `REACH` rows, and a run of equal readings waits until the test can
    tell whether it is stuck; rows are returned in whole blocks. For a fixed lag, a row waits for `ahead` rows. The
    boundaries between pushes have no influence.

    Parameters
    ----------
    limits : Limits
        The limits of the healthy channel.
    ahead : int
        Largest number of later rows that a row waits for; `REACH` for a smoother.
    """

    def __init__(self, limits: Limits, ahead: int = REACH) -> None:
        self._rule, self._largest, self._stuck = limits.outliers, limits.largest, stuck_at_once(limits)
        self._settings, self._ahead = packed_rule(self._rule), ahead
        # Readings, possible readings (otherwise NaN) and verdicts of the last returned and the waiting rows; the steps
        # before the waiting rows only.
        self._z = self._seen = np.empty(0)
        self._codes, self._elapsed = np.empty(0, np.int8), np.empty(0)
        self._returned = 0  # number of rows in `_z` that were already returned

    def push(self, z: Floats, elapsed: Floats) -> tuple[Floats, Floats, Codes]:
        """Take readings (B,) and the steps before them.

        Returns
        -------
        (float array, float array, int8 array)
            The readings of the next rows, the steps before them, and a verdict for each reading from its neighbours:
            `Verdict.OUTLIER`, `Verdict.STUCK`, or 0.
        """
        self._add(z, elapsed)
        ready = self._mark(whole=False) - self._returned
        return self._take(ready // BLOCK * BLOCK if self._ahead == REACH else ready)

    def finish(self) -> tuple[Floats, Floats, Codes]:
        """Return the waiting rows, in the form of `push`."""
        self._mark(whole=True)
        return self._take(len(self._elapsed))

    def state_dict(self) -> dict[str, Any]:
        """Return the state that later rows depend on, as arrays."""
        waiting = {"ahead_z": self._z, "ahead_elapsed": self._elapsed, "ahead_codes": self._codes}
        return waiting | {"ahead_returned": np.array([self._returned])}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`; raise a ModelError if it does not fit this lag."""
        z, elapsed, codes, count = (np.array(arrays[f"ahead_{name}"]) for name in ("z", "elapsed", "codes", "returned"))
        fits = z.dtype == elapsed.dtype == np.float64 and codes.dtype == np.int8 and count.dtype == np.int64
        if not (fits and count.shape == (1,) and z.shape == codes.shape == (z.size,) and 0 <= count[0] <= REACH):
            raise ModelError("The snapshot's waiting rows do not fit this lag; pass what snapshot() returned.")
        returned = int(count[0])
        if not (elapsed.shape == (z.size - returned,) and (elapsed >= 0).all()):
            raise ModelError("The snapshot's waiting rows go back in time, or are incomplete; it is damaged.")
        self._z, self._seen, self._elapsed, self._codes = z, self._possible(z), elapsed, codes
        self._returned = returned

    def _possible(self, z: Floats) -> Floats:
        return np.where((np.abs(z) <= self._largest) & (z != self._rule.blank), z, np.nan)

    def _add(self, z: Floats, elapsed: Floats) -> None:
        self._z, self._seen = np.append(self._z, z), np.append(self._seen, self._possible(z))
        self._codes = np.append(self._codes, np.zeros(len(z), np.int8))
        self._elapsed = np.append(self._elapsed, elapsed)

    def _mark(self, *, whole: bool) -> int:
        self._codes[self._returned :] = 0
        return scan_outliers(
            self._settings,
            self._seen,
            self._codes,
            distance=self._rule.distance,
            stuck=self._stuck,
            judged_rows=self._returned,
            whole=whole,
            ahead=self._ahead,
        )

    def _take(self, count: int) -> tuple[Floats, Floats, Codes]:
        rows = slice(self._returned, self._returned + count)
        z, elapsed = self._z[rows], self._elapsed[:count]
        codes = self._codes[rows].copy()
        kept = max(rows.stop - REACH, 0)
        self._z, self._seen, self._codes = self._z[kept:], self._seen[kept:], self._codes[kept:]
        self._elapsed, self._returned = self._elapsed[count:], rows.stop - kept
        return z, elapsed, codes
