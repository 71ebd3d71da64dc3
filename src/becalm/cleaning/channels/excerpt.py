"""Filter only some rows of a channel; the estimates equal those of a run over all rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels.faults import SensorWatch, merged_verdicts
from becalm.cleaning.channels.filters import Filter
from becalm.cleaning.channels.holes import Holes
from becalm.cleaning.channels.judging import Uncertainty
from becalm.cleaning.channels.slopes import TimingNoise
from becalm.cleaning.recipes.limits_entry import limits_of, outlier_test_rows
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import LimitsRecipe
from becalm.core.arrays import BLOCK, Codes, Floats, Integers
from becalm.core.health.sentinel import Sentinel
from becalm.core.reading_verdicts import Verdict
from becalm.core.rows import EstimatedRows

_BLOCK_ROWS = 1 << 19
"""Number of rows that are pushed into a filter at once."""

_IMPOSSIBLE = np.isin(list(Verdict), (Verdict.NONFINITE, Verdict.OVERRANGE, Verdict.OUTLIER))

_GATED = 1024  # additional rows of run-up for a gate, whose state also contains the last readings that it rejected


class UsableReadings(NamedTuple):
    """The readings of a channel that may enter a filter."""

    readings: Floats  # (N,) NaN in rows without a usable reading
    verdicts: Codes  # (N,)
    longest_gap: float  # longest time between two successive usable readings, in steps


class ChannelRows:
    """The rows of one channel, and its usable readings under given limits.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit; NaN where missing.
    elapsed : (N,) float array
        Steps since the previous row.
    step_s : float
        One step, in seconds.
    limits : LimitsRecipe or None
        Limits of the sensor, for `plottable`.
    """

    def __init__(self, z: Floats, elapsed: Floats, step_s: float, limits: LimitsRecipe | None = None) -> None:
        self.z, self.elapsed, self.step_s, self._limits = z, elapsed, step_s, limits
        self._healthy: dict[tuple[LimitsRecipe | None, int], UsableReadings] = {}

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.z)

    def healthy(self, limits: LimitsRecipe | None, lag: int | None = 0) -> UsableReadings:
        """Return the readings that may enter a filter with a lag in rows (None: a smoother), from a cache if it can."""
        key = _reading_limits(limits), outlier_test_rows(limits, lag)
        usable = self._healthy.get(key)
        if usable is None:
            watch = SensorWatch(key[0], self.step_s, has_innovations=False, ahead=key[1])
            readings = np.concatenate([watch.push(self.z, self.elapsed)[0], watch.finish()[0]])
            nothing = np.empty(len(self.z))
            (rows,) = watch.with_verdicts(
                [EstimatedRows(nothing, nothing, nothing[np.newaxis], np.zeros(len(self.z), np.int8))]
            )
            usable = UsableReadings(readings, rows.verdicts, self._longest_gap(readings))
            self._healthy = {**({} if len(self._healthy) > 1 else self._healthy), key: usable}
        return usable

    def without_spikes(self, spikes: Integers, limits: LimitsRecipe | None, lag: int | None = 0) -> ChannelRows:
        """Return a copy without the readings in the rows `spikes`, as if a gate had rejected these readings."""
        healthy, other = self.healthy(limits, lag), ChannelRows(self.z, self.elapsed, self.step_s, self._limits)
        readings, verdicts = healthy.readings.copy(), healthy.verdicts.copy()
        readings[spikes], verdicts[spikes] = np.nan, Verdict.SPIKE
        key = _reading_limits(limits), outlier_test_rows(limits, lag)
        other._healthy = {key: UsableReadings(readings, verdicts, self._longest_gap(readings))}
        return other

    def plottable(self, part: slice) -> Floats:
        """Return the readings of some rows to plot: NaN for impossible ones and outliers, which extend the scale."""
        verdicts = self.healthy(self._limits).verdicts[part]
        return np.where(_IMPOSSIBLE[verdicts], np.nan, self.z[part]) if verdicts.any() else self.z[part]

    def _longest_gap(self, readings: Floats) -> float:
        """Return the longest time between two successive finite readings, in steps."""
        longest = float(self.elapsed[1:].max(initial=0.0))
        missing = np.flatnonzero(~np.isfinite(readings))
        # Each run of missing readings begins at one of `starts`; a run at the start of the record is not a gap.
        starts = np.flatnonzero(np.diff(missing, prepend=-1) > 1)
        if not len(starts):
            return longest
        first, last = missing[starts], missing[np.append(starts[1:] - 1, -1)]
        between = last < len(readings) - 1
        bounds = np.column_stack([first[between], last[between] + 1]).ravel()
        return longest if not len(bounds) else max(longest, float(self._between(bounds).max()))

    def _between(self, bounds: Integers) -> Floats:
        """Return, for each pair (a, b) of rows in `bounds`, the steps from row a - 1 to row b."""
        sums = np.add.reduceat(self.elapsed, bounds)[::2]
        return sums + self.elapsed[bounds[1::2]]


def _reading_limits(limits: LimitsRecipe | None) -> LimitsRecipe | None:
    """Return the limits without the thresholds of alarms, which depend on innovations and not only on readings."""
    return None if limits is None else limits.model_copy(update={"drift_threshold": None, "dead_variance": None})


class _PostProcessing:
    """The steps after a filter: correct estimates in holes, remove implausible estimates, widen sigma."""

    def __init__(self, recipe: ChannelRecipe, used: Filter, step_s: float) -> None:
        is_smoothed = used.lag is None
        self._holes = Holes(recipe.hole, recipe.own_steps(step_s)) if is_smoothed and recipe.hole else None
        self._sentinel = Sentinel(limits_of(recipe.limits), recipe.hole_sigma)
        self._timing = None if recipe.timing is None else TimingNoise(recipe.timing, used.noise_std, step_s)
        self._uncertainty = Uncertainty(recipe.tuning_spread, recipe.calibration, recipe.limits)
        self._verdicts = np.empty(0, np.int8)

    def push(self, usable: Floats, elapsed: Floats, verdicts: Codes) -> None:
        """Take the next rows before their estimates: readings, steps since the previous row, and verdicts so far."""
        self._sentinel.push(usable)
        self._verdicts = np.append(self._verdicts, verdicts)
        if self._holes is not None:
            self._holes.push(elapsed)
        if self._timing is not None:
            self._timing.push(elapsed)

    def process(self, estimates: Sequence[EstimatedRows], *, is_last: bool) -> list[EstimatedRows]:
        """Take the filter's estimates of the next rows and return the final estimates that are ready."""
        if self._holes is not None:
            estimates = [*self._holes.corrected(estimates), *(self._holes.finish() if is_last else [])]
        return self._uncertainty.widened([self._plausible(rows) for rows in estimates])

    def _plausible(self, rows: EstimatedRows) -> EstimatedRows:
        count = len(rows.signal)
        before, self._verdicts = self._verdicts[:count], self._verdicts[count:]
        rows = self._sentinel.mark_implausible(rows._replace(verdicts=merged_verdicts(rows.verdicts, before)))
        return rows if self._timing is None else self._timing.widened(rows)


class ChannelRun:
    """A run of a channel's filter over all rows of the channel, or over a part of them.

    Parameters
    ----------
    rows : ChannelRows
        Rows of the channel.
    recipe : ChannelRecipe
        Recipe with a motion.
    lag : int or None
        Lag in rows: 0 for a causal filter, None for a smoother.

    Raises
    ------
    RecipeError
        If the recipe's parameters do not make a valid filter.
    """

    def __init__(self, rows: ChannelRows, recipe: ChannelRecipe, lag: int | None) -> None:
        self._rows, self._recipe, self._lag = rows, recipe, lag
        self.filter = Filter(recipe, rows.step_s, lag)
        self.healthy = rows.healthy(recipe.limits, lag)
        readings = self.filter.readings_to_forget + (0 if recipe.gate is None else _GATED)
        self._margin = int(min(readings, len(rows))) + BLOCK

    @property
    def run_up_rows(self) -> int:
        """Return the least number of rows that must be filtered before the wanted rows, at most the whole record."""
        return min(self._margin if self._bridges_all() else len(self._rows), len(self._rows))

    def estimates_of(self, first: int, stop: int) -> Iterator[EstimatedRows]:
        """Yield the estimates of rows `first` to `stop` - 1, in parts; the filter starts earlier, as far as needed."""
        begin, end = self._rows_to_filter(first, stop)
        flow, at = self.filter.open_signal_flow(), begin
        after_filter = _PostProcessing(self._recipe, self.filter, self._rows.step_s)
        for start in range(begin, end, _BLOCK_ROWS):
            part = slice(start, min(start + _BLOCK_ROWS, end))
            readings, elapsed = self.healthy.readings[part], self._rows.elapsed[part]
            estimates = flow.push(readings, elapsed)
            if part.stop == end:
                estimates = [*estimates, *flow.finish()]
            after_filter.push(readings, elapsed, self.healthy.verdicts[part])
            for rows in after_filter.process(estimates, is_last=part.stop == end):
                wanted = slice(max(first - at, 0), max(min(stop - at, len(rows.signal)), 0))
                at += len(rows.signal)
                if wanted.start < wanted.stop:
                    yield rows.rows(wanted)

    def _rows_to_filter(self, first: int, stop: int) -> tuple[int, int]:
        """Return the row to start with and the row to stop before.

        Estimates in a hole depend on the readings at both of its ends, so that these are filtered too.
        """
        used = np.flatnonzero(np.isfinite(self.healthy.readings))
        before, after = np.searchsorted(used, first, "right") - 1, np.searchsorted(used, stop - 1)
        first = int(used[before]) if before >= 0 else 0
        if self._lag is None:
            stop = int(used[after]) + 1 if after < len(used) else len(self._rows)
        return self._start_row(first), self._stop_row(stop)

    def _start_row(self, first: int) -> int:
        """Return the row to start with; from there to `first` are enough readings, over a long enough time."""
        if not self._bridges_all():
            return 0
        rows = self._margin + self._margin // 4
        while first > rows:
            begin = (first - rows) // self.filter.row_multiple * self.filter.row_multiple
            if self._is_long(slice(begin, first)):
                return begin
            rows *= 2
        return 0

    def _stop_row(self, stop: int) -> int:
        """Return the row to stop before; from `stop` to there are enough rows."""
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
        """Return whether a part has enough readings, and lasts enough steps, for a run-up."""
        readings = np.count_nonzero(np.isfinite(self.healthy.readings[part]))
        return bool(readings >= self._margin and self._rows.elapsed[part].sum() >= self._margin)

    def _bridges_all(self) -> bool:
        """Return whether the filter predicts across every gap of the record, in whatever row it starts."""
        limit, gap = self.filter.gap_limit, self.healthy.longest_gap
        return bool(gap <= min(limit.longest, limit.spans * self._margin))
