"""Find the limits of a healthy channel from a record: saturation limits, resolution, longest run of equal readings.

The lengths of runs of equal readings have a geometric tail. With noise, a reading equals the previous reading with a
probability p of about LSB / (2 sqrt(pi) sigma), and a slow signal leaves its code at a nearly constant rate. So the
runs longer than a threshold give p, and p^n is the probability that a run lasts n readings longer. With coarse codes
the record may not contain the worst case: a level in the middle of a code stays there longer than a level at its edge.
The spread of the codes gives sigma, and sigma gives the length of such runs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Booleans, Floats, Integers
from becalm.core.health.held_readings import repeats_readings
from becalm.core.health.outlier_rule import MOST_OUTLIERS, NO_OUTLIERS, Outliers, find_outlier_rule, is_outlier
from becalm.core.health.saturation import SaturationLimits, find_saturation, is_noisy
from becalm.core.model.parts import find_largest
from becalm.core.reading_verdicts import BEYOND_ANY_SENSOR
from becalm.core.time.clock import GAP_STEPS
from becalm.errors import UsageError
from becalm.native.library import SETTINGS
from becalm.native.scans import EVERY_REPEAT

_MARGIN = 2.0  # a limit over the longest run, or over the longest usual step, in the record
_WIDE_MARGIN = 10.0  # a limit over the longest run, if only the signal ends runs
_FEWEST_RUNS = 50  # least number of runs that determine the tail; a single reading is also a run
_MOST_FAULTS = 10  # largest number of runs of a record in which the channel may have been stuck
_TAIL, _FEWEST_IN_TAIL = 0.05, 20  # share and least number of the runs that make the tail
_UNSEEN = 3.0  # upper 95 % limit of the Poisson mean if no event was observed
_FEWEST_OF_A_SIDE = 5  # least number of readings on each side of the edge between two codes, to locate the edge
_LATTICE = 1e-5  # largest distance of a reading from its code, over the step: rounding of text and arithmetic
_ROUNDED = 1e-4  # largest error of a distance, over the step, while the step is not yet accurate
_FEWEST_CODES = 3  # least number of codes; two codes always form a lattice
_MOST_CODES = 1 << 16  # largest number of values in the search for a lattice
_MOST_ALIKE = 0.95  # least share of readings with repeated values for which only repeated values give the step
_EVEN, _EVEN_SHARE = 0.1, 0.95  # in even time this share of rows is this close to whole steps (in steps) or closer
_SLOW = 1e-3  # largest mean deviation from whole steps in even time, in steps
_LEAVES = 1 / 36  # jump over the plausible range: a value that noise leaves by larger jumps marks missing readings
_ENDLESS = 1 << 53  # number of equal readings in a row that no record reaches


class Limits(NamedTuple):
    """The limits of a channel while it is healthy.

    Attributes
    ----------
    low, high : float
        Saturation limits (rails), in unit: readings at a limit or beyond are clipped; -inf and inf if unknown.
    resolution : float
        The step between two codes, in unit; 0 if the readings do not lie on a lattice.
    stuck_readings : int or None
        This many equal readings in a row mean that the channel is stuck; None if any number may be equal. A *small*
        number detects a fault sooner, but also flags slow signals.
    gap_steps : float
        More steps than this since the row before are a gap.
    even : bool
        Whether rows come at even times; only then a row can be late.
    largest : float
        Readings of a greater magnitude, in unit, are impossible.
    outliers : Outliers
        The rule for gross outliers, from the jumps between readings.
    """

    low: float = -np.inf
    high: float = np.inf
    resolution: float = 0.0
    stuck_readings: int | None = None
    gap_steps: float = GAP_STEPS
    even: bool = True
    largest: float = BEYOND_ANY_SENSOR
    outliers: Outliers = NO_OUTLIERS

    @property
    def rails(self) -> SaturationLimits:
        """Return the saturation limits."""
        return SaturationLimits(self.low, self.high)

    def packed(self) -> NDArray[np.void]:
        """Return the limits in C's settings struct; the other fields are not set."""
        settings, rule = np.zeros((), SETTINGS), self.outliers
        settings["low"], settings["high"], settings["largest"] = self.low, self.high, self.largest
        settings["largest_accepted"] = np.inf
        settings["stuck"] = min(self.stuck_readings or 0, _ENDLESS)
        settings["outlier_distance"], settings["repeats_are_one"] = rule.causal_distance, rule.repeats_are_one
        settings["plausible_low"], settings["plausible_high"], settings["blank"] = rule.low, rule.high, rule.blank
        settings["far_from_0"] = rule.far_from_0
        return settings


def find_limits(
    z: Floats,
    elapsed: Floats,
    false_alarms_per_hour: float,
    step_s: float,
    sensor_range: tuple[float, float] | None = None,
) -> Limits:
    """Find the limits of a channel from a record, which may have a few stuck stretches itself.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit; NaN where missing.
    elapsed : (N,) float array
        Steps since the row before; 0 for the first.
    false_alarms_per_hour : float
        Rate at which healthy readings may be flagged as stuck; a *small* rate trusts the sensor.
    step_s : float
        One step, in seconds.
    sensor_range : (float, float), optional
        Known saturation limits, in unit; used as they are.

    Returns
    -------
    Limits
        The limits of the channel; those that the record does not determine are infinite or None. A record cannot show
        how long the runs of a slower signal are, so it should include the slowest motion of the signal.

    Raises
    ------
    UsageError
        If the rate or the step is not above 0, or the range is not from low to high.
    """
    if not (0 < false_alarms_per_hour < np.inf and 0 < step_s < np.inf):
        raise UsageError(
            f"false_alarms_per_hour = {false_alarms_per_hour!r} and step_s = {step_s!r} came; both must be above 0,"
            " as in find_limits(z, elapsed, 1.0, 0.002)."
        )
    if sensor_range is not None and not sensor_range[0] < sensor_range[1]:
        raise UsageError(f"sensor_range = {sensor_range!r} is not a range; give (low, high), as in (-50.0, 50.0).")
    largest = find_largest(z)
    kept = (np.abs(z) <= largest) & ((elapsed != 0) | (np.arange(len(z)) == 0))  # possible, and not at a repeated time
    readings = np.asarray(z[kept])
    resolution = find_resolution(readings)
    near_others = readings[~_isolated(np.cumsum(elapsed)[kept])]
    outliers = find_outlier_rule(near_others, held=repeats_readings(readings, resolution), resolution=resolution)
    rails = (
        find_saturation(readings[readings != outliers.blank], resolution)
        if sensor_range is None
        else SaturationLimits(*sensor_range)
    )
    hours = float(elapsed[kept].sum()) * step_s / 3600
    plain = readings[~rails.reached(readings) & ~is_outlier(readings, outliers)]
    repeats = repeats_readings(plain, resolution)
    stuck = EVERY_REPEAT if repeats else _stuck_readings(plain, resolution, false_alarms_per_hour * hours, outliers)
    gap_steps, even = _rhythm(elapsed[1:])
    return Limits(rails.low, rails.high, resolution, stuck, gap_steps, even, largest, outliers)


def _isolated(steps: Floats) -> Booleans:
    """Return which readings, at times `steps` (N,), have a gap on both sides, so that they have no near neighbours.

    If many readings have such gaps, the gaps are normal for the channel, and no reading counts as isolated.
    """
    waits = np.diff(steps)
    if not len(waits):
        return np.zeros(len(steps), bool)
    late = np.concatenate([[True], waits > _MARGIN * np.quantile(waits, 1 - MOST_OUTLIERS), [True]])
    return np.asarray(late[:-1] & late[1:])


def stuck_at_once(limits: Limits) -> int:
    """Return the length of a run in which even the first reading is stuck, for a test with a delay; 0 if there is none.

    Only a channel that hardly ever repeats a reading has such a length. In others the first reading may be good.
    """
    stuck = limits.stuck_readings or 0
    return stuck if limits.outliers.repeats_are_one and stuck > EVERY_REPEAT else 0


def find_resolution(z: Floats) -> float:
    """Return the step of the lattice on which finite readings (N,) lie, in unit; 0 if there is no lattice.

    A few unique readings, such as outliers, need not lie on the lattice. Steps below a billionth of the largest reading
    cannot be distinguished from rounding.
    """
    values, counts = np.unique(z, return_counts=True)
    often = counts > 1
    are_codes = counts[often].sum() >= _MOST_ALIKE * len(z)
    return (_step_of(values[often]) if are_codes else 0.0) or _step_of(values)


def _step_of(values: Floats) -> float:
    """Return the step of the lattice of sorted values, by Euclid's algorithm on their distances; 0 if there is none."""
    values = values[:: -(-len(values) // _MOST_CODES) or 1]
    if len(values) < _FEWEST_CODES:
        return 0.0
    distances = np.diff(values)
    least = 1e-9 * float(np.abs(values[[0, -1]]).max())
    step = float(distances.min())
    while step > least:
        codes = np.round(distances / step)
        near = np.abs(distances - step * codes) <= _ROUNDED * step * codes
        step = float(distances[near].sum() / codes[near].sum()) if near.any() else step
        off = np.abs(distances - step * codes)
        off = off[off > _ROUNDED * step]
        if not len(off):
            place = (values - values[0]) / step
            return step if np.abs(place - np.round(place)).max() <= _LATTICE else 0.0
        step = float(off.min())
    return 0.0


def run_lengths(z: Floats) -> Integers:
    """Return the length of each run of equal readings; z is (N,)."""
    ends = np.flatnonzero(np.append(z[1:] != z[:-1], True)) if len(z) else np.empty(0, dtype=np.int64)
    return np.diff(ends, prepend=-1)


def _stuck_readings(z: Floats, resolution: float, alarms: float, outliers: Outliers) -> int | None:
    """Return the run length that healthy readings (N,) exceed less than `alarms` times; None if it is unknown.

    Up to ten of the longest runs are faults, and are left out, if they are far longer than the other runs. If the noise
    is smaller than a code, only the signal ends a run, at an unknown rate; then the margin is wider.
    """
    runs = run_lengths(z)
    if len(runs) < _FEWEST_RUNS or not alarms > 0:
        return None
    order = np.argsort(runs, kind="stable")
    few = np.isin(np.arange(len(runs)), order[-_MOST_FAULTS:])
    noisy = is_noisy(z[np.repeat(~few, runs)], resolution)
    margin, most = (_MARGIN, _MOST_FAULTS) if noisy else (_WIDE_MARGIN, 1)
    hold, lengths = _longest_hold(z, alarms), runs[order]
    limits = [margin * max(hold, _longest_run(lengths[: len(runs) - k], alarms)) for k in range(most + 1)]
    last = np.cumsum(runs)[order] - 1
    faults = max(
        k
        for k in range(most + 1)
        if not k or (lengths[-k] > limits[k] and _are_faults(z, last[-k:], lengths[-k:], noisy, outliers))
    )
    return int(np.ceil(limits[faults])) if limits[faults] <= len(z) else None


def _are_faults(z: Floats, last: Integers, lengths: Integers, noisy: bool, outliers: Outliers) -> bool:
    """Return whether the runs that end at the rows `last` (k,) are faults and not a signal at rest.

    A run of 0 at an end of the range is a signal at rest, if 0 can be a reading. So are several runs of one value,
    unless the readings are noisy and leave this value by jumps: then the value marks missing readings.
    """
    run_values = z[last]
    if 0.0 in run_values and (z.min() == 0 or z.max() == 0) and not outliers.far_from_0:
        return False
    neighbours = np.maximum(last - lengths, 0), np.minimum(last + 1, len(z) - 1)
    jumps = np.min([np.abs(z[rows] - run_values) for rows in neighbours], axis=0)
    leaves = noisy and bool(np.median(jumps) > _LEAVES * (outliers.high - outliers.low))
    return leaves or len(np.unique(run_values)) == len(run_values)


def _longest_run(runs: Integers, alarms: float) -> float:
    """Return the length that runs exceed `alarms` times per record, by the geometric tail of the sorted lengths."""
    count = max(_FEWEST_IN_TAIL, int(_TAIL * len(runs)))
    threshold = int(runs[-count])
    tail = runs[np.searchsorted(runs, threshold) :]
    beyond = float((tail - threshold).sum()) + _UNSEEN
    p = beyond / (beyond + len(tail))
    return max(float(runs[-1]), threshold + _times(p, len(tail) / alarms))


def _longest_hold(z: Floats, alarms: float) -> float:
    """Return the run length that a noisy level in the middle of a code exceeds `alarms` times; inf if unknown.

    The two edges of a code are normal quantiles whose difference is LSB / sigma; motion only reduces the difference.
    """
    from scipy.special import ndtr, ndtri

    _, counts = np.unique(z, return_counts=True)
    below = np.cumsum(counts)[:-1]
    edges = below[(below >= _FEWEST_OF_A_SIDE) & (below <= len(z) - _FEWEST_OF_A_SIDE)]
    if len(edges) < _FEWEST_CODES - 1:
        return np.inf
    first, last = ndtri(edges[[0, -1]] / len(z))
    width = (last - first) / (len(edges) - 1)
    return _times(float(2 * ndtr(width / 2) - 1), len(z) / alarms)


def _times(p: float, count: float) -> float:
    """Return the n for which count * p^n = 1."""
    if count <= 1 or p <= 0:
        return 0.0
    return float(np.log(count) / -np.log(p)) if p < 1 else np.inf


def _rhythm(elapsed: Floats) -> tuple[float, bool]:
    """Return the number of steps between two rows beyond which rows were lost, and whether time is even.

    In even time nearly all rows come a whole number of steps after the previous row, and the deviations cancel. In
    uneven time the number is twice the 99 % quantile of the steps.
    """
    off = elapsed - np.maximum(np.round(elapsed), 1.0)
    near = np.abs(off[elapsed > 0])
    if not len(near):
        return GAP_STEPS, True
    if np.mean(near <= _EVEN) >= _EVEN_SHARE and abs(float(off[elapsed > 0].mean())) <= _SLOW:
        return GAP_STEPS, True
    return max(GAP_STEPS, _MARGIN * float(np.quantile(elapsed, 0.99))), False
