"""The measures of an estimate of a damaged record, and their bounds.

- *largest error*: the largest error in any row, relative to the range of undamaged readings within 100 rows (in a hole
  of n rows, within 100 + n); a converter's step is added to the range. At most 1.
- *away*: the rms error farther than 200 rows from the insult, relative to that of the undamaged record in the same rows
  (if an insult is everywhere, farther than 20 rows, or in all rows that it did not touch). At most 1.1 in 95 % of the
  cases, and never above 1.5. A record in which each reading occurs k times, or only every k-th row has a reading, is
  compared with the undamaged record at that slower rate, in the rows with a new reading; a converter with step d may
  add d^2/12 to the mean square.
- *inside*: the rms error in hidden rows, relative to the better of two rivals, the record's mean and a line across the
  hole. A causal line is the level before the hole; a lagged line is that level until rows after the hole are known.
  A line joins the means of 1, 4, 16 or 64 undamaged readings on either side. The best rival is chosen with the
  truth on the undamaged record, in holes of the same length all over it, and its error counts as no less than there,
  because it may be small in one hole by chance. At most 1.1. Rows whose estimate is NaN are counted and left out. With
  fewer than eight rows there is no result.
- *lost*: the number of rows that are NaN although their reading is good, and that were not NaN before the damage. 0.
- *near*, *elsewhere*: the share of rows whose truth is within one sigma, within 100 rows of the insult or farther. It
  must be 55 to 80 %, give or take two standard errors of that share; the number of independent rows is taken as the
  number of runs of one sign of the error.
- *cut off*: the number of readings of a shock or a step that a smoother rejects as spikes. 0.
- *raised*: the number of exceptions. 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, maximum_filter1d, minimum_filter1d

from safe_signals import Flags, Floats, Record

AROUND, AWAY, CLOSE = 100, 200, 20
MEANS = (1, 4, 16, 64)
_TRIALS = 60  # holes on an undamaged record
_FEW = 8  # smallest number of hidden rows for *inside*
_FEWEST = 40  # smallest number of rows for *near* and *elsewhere*
_BEHIND = {"smoothed": None, "causal": 0, "lag": 20}  # later rows that an estimate knows; None for all

LIMITS = {
    "largest error": 1.0,
    "away": 1.5,
    "inside": 1.1,
    "lost": 0.0,
    "near": 0.0,
    "elsewhere": 0.0,
    "cut off": 0.0,
    "raised": 0.0,
}
"""Upper bound of each measure; the measures `near` and `elsewhere` are the excess of coverage beyond 55 to 80 %."""

OFTEN = 1.1
"""Upper bound of *away* in 95 % of the cases."""


class Estimate(NamedTuple):
    """The output of a filter: signal and sigma (N,), and whether each reading was rejected as a spike (N,)."""

    signal: Floats
    sigma: Floats
    spikes: Flags


def runs_of(flags: Flags) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first row of each run of flags, and the first row after it."""
    edges = np.diff(np.concatenate([[0], flags.astype(np.int8), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def within(flags: Flags, rows: int) -> Flags:
    """Return flags of the rows that are at most `rows` rows from a flag."""
    return np.asarray(binary_dilation(flags, np.ones(2 * rows + 1, bool))) if flags.any() else flags.copy()


def ranges(record: Record) -> Floats:
    """Return the range of undamaged readings around each row (N,)."""
    rows = len(record.sound)
    length = np.zeros(rows, int)
    for start, stop in zip(*runs_of(record.hidden), strict=True):
        length[start:stop] = stop - start
    found = np.empty(rows)
    for each in np.unique(length):
        size = min(2 * (AROUND + int(each)) + 1, 2 * rows - 1)
        span = maximum_filter1d(record.sound, size) - minimum_filter1d(record.sound, size)
        found[length == each] = span[length == each]
    return found + record.resolution


def largest_error(signal: Floats, record: Record) -> float:
    """Return the largest error, relative to the range of the readings around it; inf for an infinite estimate."""
    if np.isinf(signal).any():
        return np.inf
    known = np.isfinite(signal)
    return float((np.abs(signal - record.truth) / ranges(record))[known].max(initial=0.0))


def away_rows(record: Record) -> Flags:
    """Return flags of the rows that are away from an insult."""
    if record.every > 1:
        return np.asarray(~record.hidden & (np.arange(len(record.truth)) % record.every == 0))
    for margin in (AWAY, CLOSE):
        away = ~within(record.touched, margin)
        if away.mean() > 0.2:
            return np.asarray(away)
    return ~record.touched


def away(estimate: Floats, sound: Floats, record: Record, rows: Flags) -> float:
    """Return the rms error in some rows, relative to that of the undamaged record.

    Parameters
    ----------
    estimate : (N,) float array
        Estimate of the damaged record.
    sound : (N,) float array
        Error of the estimate of the undamaged record.
    record : Record
        The damaged record.
    rows : (N,) bool array
        Flags of the rows to compare.
    """
    rows = rows & np.isfinite(estimate) & np.isfinite(sound)
    if not rows.any():
        return np.nan
    least = np.mean(sound[rows] ** 2) + record.resolution**2 / 12
    return float(np.sqrt(np.mean((estimate - record.truth)[rows] ** 2) / least))


def bridge(record: Record, hidden: Flags, count: int, ahead: int | None) -> Floats:
    """Return a line across hidden rows, which joins the means of undamaged readings on either side.

    Parameters
    ----------
    record : Record
        Record, whose undamaged readings are used.
    hidden : (N,) bool array
        Flags of the rows to bridge.
    count : int
        Number of readings in a mean.
    ahead : int or None
        Number of later rows that are known in each row; None for all.

    Returns
    -------
    (N,) float array
        The line; NaN in rows that are not hidden, and where no reading is known.
    """
    rows, good, bad = len(hidden), np.flatnonzero(~hidden), np.flatnonzero(hidden)
    found = np.full(rows, np.nan)
    if not len(good):
        return found
    sums = np.concatenate([[0.0], np.cumsum(record.sound[good] - record.sound[good[0]])])
    places = np.concatenate([[0.0], np.cumsum(good.astype(float))])
    at = np.searchsorted(good, bad)
    low, high = np.maximum(at - count, 0), np.minimum(at + count, len(good))
    with np.errstate(invalid="ignore"):
        before = (sums[at] - sums[low]) / (at - low) + record.sound[good[0]]
        after = (sums[high] - sums[at]) / (high - at) + record.sound[good[0]]
        row_before = (places[at] - places[low]) / (at - low)
        row_after = (places[high] - places[at]) / (high - at)
    line = before + (after - before) * (bad - row_before) / (row_after - row_before)
    seen = np.ones(len(bad), bool) if ahead is None else good[high - 1] <= bad + ahead
    line = np.where(seen, line, before)
    known = np.where(np.isnan(before) & seen, after, before)
    found[bad] = np.where(np.isfinite(line), line, known)
    return found


def rival(record: Record, ahead: int | None) -> tuple[Floats, float]:
    """Return the better of line and mean in the hidden rows (N,), and its rms error in holes all over the record."""
    starts, stops = runs_of(record.hidden)
    rows, length = len(record.truth), int(np.median(stops - starts))
    trial = np.zeros(rows, bool)
    pitch = max(length + 2 * max(MEANS), rows // _TRIALS)
    for start in range(max(MEANS), rows - length, pitch):
        trial[start : start + length] = True
    mean = float(np.mean(record.sound))
    errors = {count: _error(bridge(record, trial, count, ahead), record.truth, trial) for count in MEANS}
    best = min(errors, key=lambda count: errors[count])
    spread = _error(np.full(rows, mean), record.truth, trial)
    if not errors[best] < spread:
        return np.full(rows, mean), spread
    found = bridge(record, record.hidden, best, ahead)
    return np.where(np.isnan(found), mean, found), errors[best]


def _error(signal: Floats, truth: Floats, rows: Flags) -> float:
    """Return the rms error in some rows, without those that are NaN."""
    off = (signal - truth)[rows]
    off = off[np.isfinite(off)]
    return float(np.sqrt(np.mean(off**2))) if len(off) else np.nan


def inside(signal: Floats, record: Record, estimate: str) -> float:
    """Return the rms error in hidden rows, relative to that of the better of a line and the mean."""
    rows = record.hidden & np.isfinite(signal)
    if rows.sum() < _FEW:
        return np.nan
    other, usual = rival(record, _BEHIND[estimate])
    return _error(signal, record.truth, rows) / max(_error(other, record.truth, rows), usual)


def coverage_excess(estimate: Estimate, truth: Floats, rows: Flags) -> float:
    """Return by how much the share of rows within one sigma is outside 55 to 80 %, less two standard errors."""
    rows = rows & np.isfinite(estimate.signal) & np.isfinite(estimate.sigma)
    if rows.sum() < _FEWEST:
        return np.nan
    error = (estimate.signal - truth)[rows]
    share = np.mean(np.abs(error) <= estimate.sigma[rows])
    apart = 1 + np.count_nonzero(np.diff(error > 0))
    chance = 2 * np.sqrt(0.22 / apart)
    return float(max(0.55 - share - chance, share - 0.80 - chance, 0.0))


def measures(estimate: Estimate, sound: Floats, record: Record, kind: str) -> dict[str, float]:
    """Return all measures of an estimate; NaN for measures without a result.

    Parameters
    ----------
    estimate : Estimate
        Estimate of the damaged record.
    sound : (N,) float array
        Error of the estimate of the undamaged record.
    record : Record
        The damaged record.
    kind : {"smoothed", "causal", "lag"}
        Kind of the estimate.
    """
    hit = record.touched | record.hidden
    near, missing = within(hit, AROUND), np.isnan(estimate.signal)
    is_motion = record.touched & ~record.hidden & np.isfinite(record.readings)
    return {
        "largest error": largest_error(estimate.signal, record),
        "away": away(estimate.signal, sound, record, away_rows(record)),
        "inside": inside(estimate.signal, record, kind),
        "NaN inside": float(np.mean(missing[record.hidden])) if record.hidden.any() else np.nan,
        "lost": float(np.count_nonzero(missing & ~record.hidden & np.isfinite(sound))),
        "near": coverage_excess(estimate, record.truth, near),
        "elsewhere": coverage_excess(estimate, record.truth, ~near),
        "cut off": float(np.count_nonzero(estimate.spikes & is_motion)) if kind == "smoothed" else np.nan,
    }
