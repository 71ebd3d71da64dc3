"""Correct a smoother's estimates in holes, where readings are missing.

A motion model that predicts the next reading well may predict badly over a long hole. `errors_in_holes` hides blocks of
readings to measure these errors. In a hole the correction reduces the departure of the estimate from a straight line,
and increases sigma. Both factors are powers of the ratio of sigma to sigma at the edge of the hole.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from becalm.cleaning.recipes.recipe_parts import HoleRecipe
from becalm.core.arrays import Booleans, Floats
from becalm.core.reading_verdicts import LOST
from becalm.core.rows import EstimatedRows


class HoleLines(NamedTuple):
    """The straight lines across the holes of a record; only rows without a reading have valid values."""

    line: Floats  # (N,) from the last estimate before the hole to the first one after it, in unit; NaN at open ends
    edge: Floats  # (N,) the smaller sigma of these two estimates, in unit
    missing: Floats  # (N,) number of missing readings in the hole


class ReadingRow(NamedTuple):
    """A row that has a reading: its time in steps, and its signal and sigma in unit."""

    time: float
    signal: float
    sigma: float


NO_ROW = ReadingRow(np.nan, np.nan, np.nan)


def lines_across_holes(
    times: Floats, estimates: EstimatedRows, used: Booleans, own_steps: float, before: ReadingRow = NO_ROW
) -> HoleLines:
    """Return the straight lines across the holes of a record.

    Parameters
    ----------
    times : (N,) float array
        Times of the rows, in steps.
    estimates : EstimatedRows
        Estimates of the same rows.
    used : (N,) bool array
        True in rows with a reading that the filter used.
    own_steps : float
        Steps from one reading to the next if none is missing.
    before : ReadingRow
        Last row with a reading before these rows.
    """
    # Time, signal and sigma in each row with a reading.
    ends = [
        np.concatenate([[first], values[used], [np.nan]])
        for first, values in zip(before, (times, *estimates[:2]), strict=True)
    ]
    number = np.cumsum(used)
    (start, y, sigma), (end, y_after, sigma_after) = (
        [values[number + later] for values in ends] for later in (0, 1)
    )  # fmt: skip
    length = end - start
    share = np.divide(times - start, length, out=np.zeros(len(times)), where=length > 0)
    edge = np.fmin(sigma, sigma_after)
    return HoleLines(y + share * (y_after - y), edge, np.maximum(length / own_steps - 1.0, 0.0))


class Holes:
    """A correction of the estimates in rows without a reading; the rows of a hole wait until the hole has ended.

    Parameters
    ----------
    corrections : sequence of HoleRecipe
        Corrections for one or more lengths of holes. Between these lengths a correction is interpolated linearly in the
        logarithm of the length. Longer holes have the correction of the longest one. A single missing reading has none.
    own_steps : float
        Steps from one reading to the next if none is missing.
    """

    def __init__(self, corrections: Sequence[HoleRecipe], own_steps: float) -> None:
        in_order = sorted(corrections, key=lambda one: one.readings)
        self._own_steps = own_steps
        self._lengths = np.log([1.0, *(one.readings for one in in_order)])
        self._fading = [0.0, *(one.model_fading for one in in_order)]
        self._growth = [0.0, *(one.sigma_growth for one in in_order)]
        self._before, self._time = NO_ROW, 0.0
        self._times: list[Floats] = []
        self._waiting: list[EstimatedRows] = []

    def push(self, elapsed: Floats) -> None:
        """Take the steps since the previous row, (B,), for each of the next rows."""
        times = self._time + np.cumsum(elapsed)
        self._times.append(times)
        self._time = float(times[-1]) if len(times) else self._time

    def corrected(self, estimates: Sequence[EstimatedRows]) -> list[EstimatedRows]:
        """Take the estimates of the next rows; return the corrected rows up to the last row with a reading."""
        self._waiting += estimates
        rows = EstimatedRows.joined(self._waiting)
        ends = np.flatnonzero(has_reading(rows))
        return self._correct(rows, int(ends[-1]) + 1) if len(ends) else []

    def finish(self) -> list[EstimatedRows]:
        """Return the remaining rows."""
        rows = EstimatedRows.joined(self._waiting)
        return self._correct(rows, len(rows.signal)) if len(rows.signal) else []

    def _correct(self, rows: EstimatedRows, count: int) -> list[EstimatedRows]:
        """Correct the first `count` of the waiting rows and return them."""
        now, self._waiting = rows.rows(slice(count)), [rows.rows(slice(count, None))]
        times = np.concatenate(self._times)
        self._times, times = [times[count:]], times[:count]
        used = has_reading(now)
        hole = lines_across_holes(times, now, used, self._own_steps, self._before)
        if used.any():
            last = int(np.flatnonzero(used)[-1])
            self._before = ReadingRow(float(times[last]), float(now.signal[last]), float(now.sigma[last]))
        return [now if used.all() else self._correct_holes(now, used, hole)]

    def _correct_holes(self, rows: EstimatedRows, used: Booleans, hole: HoleLines) -> EstimatedRows:
        """Return the rows; those without a reading (`used` is False) are corrected."""
        length = np.log(np.maximum(np.nan_to_num(hole.missing, nan=np.inf), 1.0))
        fading, growth = (np.interp(length, self._lengths, powers) for powers in (self._fading, self._growth))
        ratio = widening(rows.sigma, hole.edge)
        line = np.where(np.isfinite(hole.line), hole.line, rows.signal)
        signal = np.where(used, rows.signal, line + ratio**-fading * (rows.signal - line))
        sigma = np.where(used, rows.sigma, rows.sigma * ratio**growth)
        parts = rows.parts
        if len(parts):
            parts = parts.copy()
            parts[0] += signal - rows.signal
        return EstimatedRows(signal, sigma, parts, rows.verdicts)


def widening(sigma: Floats, edge: Floats) -> Floats:
    """Return sigma divided by sigma at the edge of the hole, (N,); 1 where the ratio is below 1 or not finite."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        ratio = sigma / edge
    return np.where((ratio > 1.0) & np.isfinite(ratio), ratio, 1.0)


def has_reading(rows: EstimatedRows) -> Booleans:
    """Return, as (N,) bool, which rows have both a reading that the filter used and an estimate."""
    return ~LOST[rows.verdicts] & np.isfinite(rows.signal)
