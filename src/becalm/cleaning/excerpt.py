"""Filter only some rows of a channel, with the same results as for filtering all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from becalm.cleaning.faults import SensorWatch, merged_verdicts
from becalm.cleaning.filters import Filter
from becalm.cleaning.holes import Holes
from becalm.cleaning.judging import Uncertainty
from becalm.cleaning.limits_entry import limits_of, rows_that_judge
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import LimitsRecipe
from becalm.cleaning.slopes import TimingNoise
from becalm.core.arrays import BLOCK, Codes, Floats, Integers
from becalm.core.health.sentinel import Sentinel
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


class _LastStages:
    """What happens to the estimates of a filter: correction in holes, removal of implausible ones, wider sigma."""

    def __init__(self, recipe: ChannelRecipe, used: Filter, step_s: float) -> None:
        is_smoothed = used.lag is None
        self._holes = Holes(recipe.hole, recipe.own_steps(step_s)) if is_smoothed and recipe.hole else None
        self._sentinel = Sentinel(limits_of(recipe.limits), recipe.unknown_from)
        self._timing = None if recipe.timing is None else TimingNoise(recipe.timing, used.noise_std, step_s)
        self._uncertainty = Uncertainty(recipe.tuning_spread, recipe.calibration, recipe.limits)
        self._verdicts = np.empty(0, np.int8)

    def push(self, usable: Floats, elapsed: Floats, verdicts: Codes) -> None:
        """Take the next rows before their estimates: usable readings, steps before them, and verdicts so far (B,)."""
        self._sentinel.push(usable)
        self._verdicts = np.append(self._verdicts, verdicts)
        if self._holes is not None:
            self._holes.push(elapsed)
        if self._timing is not None:
            self._timing.push(elapsed)

    def process(self, estimates: Sequence[EstimatedRows], *, is_last: bool) -> list[EstimatedRows]:
        """Return the rows that are ready."""
        if self._holes is not None:
            estimates = [*self._holes.bridged(estimates), *(self._holes.finish() if is_last else [])]
        return self._uncertainty.widened([self._plausible(rows) for rows in estimates])

    def _plausible(self, rows: EstimatedRows) -> EstimatedRows:
        count = len(rows.signal)
        before, self._verdicts = self._verdicts[:count], self._verdicts[count:]
        rows = self._sentinel.mark_implausible(rows._replace(verdicts=merged_verdicts(rows.verdicts, before)))
        return rows if self._timing is None else self._timing.widened(rows)


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
        begin, end = self._run_for(first, stop)
        flow, last_stages, at = self.filter.alone(), _LastStages(self._recipe, self.filter, self._rows.step_s), begin
        for start in range(begin, end, _PUSHED):
            part = slice(start, min(start + _PUSHED, end))
            readings, elapsed = self.healthy.readings[part], self._rows.elapsed[part]
            estimates = flow.push(readings, elapsed)
            if part.stop == end:
                estimates = [*estimates, *flow.finish()]
            last_stages.push(readings, elapsed, self.healthy.verdicts[part])
            for rows in last_stages.process(estimates, is_last=part.stop == end):
                wanted = slice(max(first - at, 0), max(min(stop - at, len(rows.signal)), 0))
                at += len(rows.signal)
                if wanted.start < wanted.stop:
                    yield rows.rows(wanted)

    def _run_for(self, first: int, stop: int) -> tuple[int, int]:
        """Return the rows to start with and to stop before; what is estimated in a hole depends on both of its ends."""
        used = np.flatnonzero(np.isfinite(self.healthy.readings))
        before, after = np.searchsorted(used, first, "right") - 1, np.searchsorted(used, stop - 1)
        first = int(used[before]) if before >= 0 else 0
        if self._lag is None:
            stop = int(used[after]) + 1 if after < len(used) else len(self._rows)
        return self._start_row(first), self._stop_row(stop)

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
