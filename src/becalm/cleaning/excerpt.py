"""Filter only some rows of a channel, with the same results as for filtering all of them.

Unlike in a cleaned file, estimates in holes are neither corrected nor removed, and runaways stay.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from becalm.cleaning.faults import SensorWatch, merged_verdicts
from becalm.cleaning.filters import Filter
from becalm.cleaning.judging import Uncertainty
from becalm.cleaning.limits_entry import rows_that_judge
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import LimitsRecipe
from becalm.cleaning.slopes import TimingNoise
from becalm.core.arrays import BLOCK, Codes, Floats, Integers
from becalm.core.reading_verdicts import Verdict
from becalm.core.rows import EstimatedRows

_PUSHED = 1 << 19
"""Rows in one block for a filter."""

_IMPOSSIBLE = np.isin(list(Verdict), (Verdict.NONFINITE, Verdict.OVERRANGE, Verdict.OUTLIER))

_GATED = 1024  # additional rows of run-up for a gate, which also depends on the readings that it rejected in a row


class UsableReadings(NamedTuple):
    """Readings that may enter a filter."""

    readings: Floats  # (N,) NaN where none may enter a filter
    verdicts: Codes  # (N,)
    longest_gap: float  # longest time between two usable readings, in steps


class ChannelRows:
    """The rows of one channel.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit; NaN where missing.
    elapsed : (N,) float array
        Steps since the previous row.
    step_s : float
        One step, in seconds.
    limits : LimitsRecipe or None
        Limits of the sensor, for `possible`.
    """

    def __init__(self, z: Floats, elapsed: Floats, step_s: float, limits: LimitsRecipe | None = None) -> None:
        self.z, self.elapsed, self.step_s, self._limits = z, elapsed, step_s, limits
        self._healthy: dict[tuple[LimitsRecipe | None, int], UsableReadings] = {}

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.z)

    def healthy(self, limits: LimitsRecipe | None, lag: int | None = 0) -> UsableReadings:
        """Return the readings that may enter a filter with a lag in rows (None: a smoother); they are cached."""
        plain = _reading_limits(limits), rows_that_judge(limits, lag)
        usable = self._healthy.get(plain)
        if usable is None:
            watch = SensorWatch(plain[0], self.step_s, shown=False, ahead=plain[1])
            readings = np.concatenate([watch.push(self.z, self.elapsed)[0], watch.finish()[0]])
            nothing = np.empty(len(self.z))
            (named,) = watch.named(
                [EstimatedRows(nothing, nothing, nothing[np.newaxis], np.zeros(len(self.z), np.int8))]
            )
            usable = UsableReadings(readings, named.verdicts, self._longest_gap(readings))
            self._healthy = {**({} if len(self._healthy) > 1 else self._healthy), plain: usable}
        return usable

    def without(self, spikes: Integers, limits: LimitsRecipe | None, lag: int | None = 0) -> ChannelRows:
        """Return the channel without the readings in rows `spikes`, as if a gate rejected them."""
        healthy, other = self.healthy(limits, lag), ChannelRows(self.z, self.elapsed, self.step_s, self._limits)
        readings, verdicts = healthy.readings.copy(), healthy.verdicts.copy()
        readings[spikes], verdicts[spikes] = np.nan, Verdict.SPIKE
        plain = _reading_limits(limits), rows_that_judge(limits, lag)
        other._healthy = {plain: UsableReadings(readings, verdicts, self._longest_gap(readings))}
        return other

    def possible(self, part: slice) -> Floats:
        """Return some readings to plot; impossible ones and outliers, which would compress the scale, are NaN."""
        verdicts = self.healthy(self._limits).verdicts[part]
        return np.where(_IMPOSSIBLE[verdicts], np.nan, self.z[part]) if verdicts.any() else self.z[part]

    def _longest_gap(self, readings: Floats) -> float:
        longest = float(self.elapsed[1:].max(initial=0.0))
        missing = np.flatnonzero(~np.isfinite(readings))
        starts = np.flatnonzero(np.diff(missing, prepend=-1) > 1)  # of each run; one at the start is not a gap
        if not len(starts):
            return longest
        first, last = missing[starts], missing[np.append(starts[1:] - 1, -1)]
        between = last < len(readings) - 1
        bounds = np.column_stack([first[between], last[between] + 1]).ravel()
        return longest if not len(bounds) else max(longest, float(self._between(bounds).max()))

    def _between(self, bounds: Integers) -> Floats:
        """Return for each pair of rows (bounds) the steps from the row before the first one to the second one."""
        sums = np.add.reduceat(self.elapsed, bounds)[::2]
        return sums + self.elapsed[bounds[1::2]]


def _reading_limits(limits: LimitsRecipe | None) -> LimitsRecipe | None:
    """Return the limits that depend on readings alone, without alarms on innovations."""
    return None if limits is None else limits.model_copy(update={"drift_threshold": None, "dead_variance": None})


class ChannelRun:
    """A run of a channel's filter over all its rows, or over some of them.

    Parameters
    ----------
    rows : ChannelRows
        The readings.
    recipe : ChannelRecipe
        Recipe with a motion.
    lag : int or None
        Lag in rows: 0 for a causal filter, None for a smoother.

    Raises
    ------
    RecipeError
        If its parameters do not make a valid filter.
    """

    def __init__(self, rows: ChannelRows, recipe: ChannelRecipe, lag: int | None) -> None:
        self._rows, self._recipe, self._lag = rows, recipe, lag
        self.filter = Filter(recipe, rows.step_s, lag)
        self.healthy = rows.healthy(recipe.limits, lag)
        kept = self.filter.forgotten_after + (0 if recipe.gate is None else _GATED)
        self._margin = int(min(kept, len(rows))) + BLOCK

    @property
    def reach(self) -> int:
        """Return the least number of rows before the wanted ones that are filtered too; all rows if necessary."""
        return min(self._margin if self._bridges_all() else len(self._rows), len(self._rows))

    def estimates_of(self, first: int, stop: int) -> Iterator[EstimatedRows]:
        """Yield the estimates of rows first to stop, in parts; the filter starts as many rows earlier as it needs."""
        recipe, rows = self._recipe, self._rows
        begin, end = self._start_row(first), self._stop_row(stop)
        flow, uncertainty = self.filter.alone(), Uncertainty(recipe.tuning_spread, recipe.calibration, recipe.limits)
        timing = None
        if recipe.timing is not None:
            timing = TimingNoise(recipe.timing, self.filter.noise_std, rows.step_s)
        at = begin
        for start in range(begin, end, _PUSHED):
            part = slice(start, min(start + _PUSHED, end))
            elapsed = rows.elapsed[part]
            if timing is not None:
                timing.push(elapsed)
            estimates = flow.push(self.healthy.readings[part], elapsed)
            for one in [*estimates, *(flow.finish() if part.stop == end else [])]:
                wider = one if timing is None else timing.widened(one)
                wanted = slice(max(first - at, 0), max(min(stop - at, len(one.signal)), 0))
                at += len(one.signal)
                if wanted.start < wanted.stop:
                    before = self.healthy.verdicts[at - len(one.signal) :][wanted]
                    yield from self._widened(uncertainty, wider.rows(wanted), before)

    def _widened(self, uncertainty: Uncertainty, estimates: EstimatedRows, before: Codes) -> list[EstimatedRows]:
        return uncertainty.widened([estimates._replace(verdicts=merged_verdicts(estimates.verdicts, before))])

    def _start_row(self, first: int) -> int:
        """Return the row to start with, so that enough readings and enough time come before `first`."""
        if not self._bridges_all():
            return 0
        rows = self._margin + self._margin // 4
        while first > rows:
            begin = (first - rows) // self.filter.aligned * self.filter.aligned
            if self._is_long(slice(begin, first)):
                return begin
            rows *= 2
        return 0

    def _stop_row(self, stop: int) -> int:
        """Return the row to stop before, so that enough rows come after `stop`."""
        last = len(self._rows)
        if self._lag is not None:
            return min(stop + self._lag, last)
        rows = self._margin + self._margin // 4
        while stop + rows < last:
            if self._is_long(slice(stop, stop + rows)):
                return stop + rows
            rows *= 2
        return last

    def _is_long(self, part: slice) -> bool:
        readings = np.count_nonzero(np.isfinite(self.healthy.readings[part]))
        return bool(readings >= self._margin and self._rows.elapsed[part].sum() >= self._margin)

    def _bridges_all(self) -> bool:
        """Return whether the filter bridges every gap of the record, wherever it starts."""
        limit, gap = self.filter.gap_limit, self.healthy.longest_gap
        return bool(gap <= min(limit.longest, limit.spans * self._margin))
