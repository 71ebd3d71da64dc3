"""Find faults of a sensor: keep faulty readings out of the filter, give verdicts to rows, and describe the faults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.recipes.limits_entry import alarms_of, limits_of, limits_recipe
from becalm.cleaning.recipes.recipe_parts import LimitsRecipe
from becalm.core.arrays import Codes, Floats
from becalm.core.filter.channel import History
from becalm.core.health.faults import FaultCount, Faults, fault_messages
from becalm.core.health.limits import Limits, find_limits, stuck_at_once
from becalm.core.health.look_ahead import LookAhead
from becalm.core.health.monitor import InnovationMonitor, noise_change_message
from becalm.core.health.outlier_rule import verdicts_from_neighbours
from becalm.core.reading_verdicts import ADVICE, LOST, Verdict
from becalm.core.rows import EstimatedRows
from becalm.native.scans import EVERY_REPEAT

FALSE_ALARMS_PER_HOUR = 1.0
"""Rate of false alarms of a healthy sensor per hour: of "stuck", and of "drift" and "dead" together.

A *small* number trusts the sensor.
"""

MOST_LOST = 0.5
"""Largest share of clipped or stuck rows; with a larger one the report calls the signal a guess."""

_PIECE = 1 << 16  # rows whose arrays stay in the cache
_COUNTED_AS_LOST = (Verdict.CLIPPED, Verdict.STUCK)  # verdicts whose share is compared with `MOST_LOST`
# For each verdict, whether that of the filter replaces that of the check before the filter.
_FROM_FILTER = np.isin(list(Verdict), [Verdict.OVERRANGE, Verdict.SPIKE, Verdict.STEP])


@dataclass(frozen=True)
class Fault:
    """A fault of a sensor, as found in a channel.

    Attributes
    ----------
    what : str
        Name of the verdict that the fault has.
    readings : int
        Number of readings with this verdict.
    first_row : int
        First row with this verdict, counted from 1.
    first_s : float
        Time of that row, in seconds after the first row.
    found_within_s : float
        Longest time from the start of such a fault to its detection, in seconds; for a drift, the mean time for one of
        one sigma. 0 if the first faulty reading shows the fault.
    """

    what: str
    readings: int
    first_row: int
    first_s: float
    found_within_s: float


class Findings(NamedTuple):
    """The faults that were found in the sensor of one channel."""

    limits: Limits  # the limits that the readings were checked against
    step_s: float
    rows: int  # number of rows so far
    reading_faults: dict[Verdict, FaultCount]  # faults of readings and of their times
    monitor: InnovationMonitor  # `found` has the faults that the innovations show

    @property
    def found(self) -> dict[Verdict, FaultCount]:
        """Return all faults. Neither a missing reading is a fault, nor a repeat if the channel repeats its readings."""
        excluded = (Verdict.MISSING, Verdict.STUCK) if self._repeats_readings else (Verdict.MISSING,)
        found = {verdict: one for verdict, one in self.reading_faults.items() if verdict not in excluded}
        return found | self.monitor.found

    @property
    def _repeats_readings(self) -> bool:
        """Return whether a row counts as missing as soon as it repeats the previous reading."""
        return self.limits.stuck_readings == EVERY_REPEAT

    def _repeats(self) -> list[str]:
        """Return a sentence on rows that only repeat the previous reading, if the channel repeats its readings."""
        found = self.reading_faults.get(Verdict.STUCK)
        if not self._repeats_readings or found is None:
            return []
        if found.readings > MOST_LOST * self.rows:
            new = self.rows / (self.rows - found.readings)
            return [
                f"The sensor is slower than its log: a new reading comes every {new:.3g} rows on average; the rows"
                " between repeat it and count as missing."
            ]
        return [f"{found.readings} of {self.rows} rows only repeat the previous reading and count as missing."]

    def faults(self) -> tuple[Fault, ...]:
        """Return each fault, with its first row and time."""
        return tuple(
            Fault(
                verdict.name.lower(),
                found.readings,
                found.first_row + 1,
                found.first_step * self.step_s,
                self._delay(verdict) * self.step_s,
            )
            for verdict, found in sorted(self.found.items())
        )

    def _delay(self, verdict: Verdict) -> float:
        """Return the largest number of readings until a fault is detected; for a drift, the mean number."""
        alarms = self.monitor.alarms
        if verdict in (Verdict.DRIFT, Verdict.DEAD):
            return alarms.drift_delay if verdict == Verdict.DRIFT else alarms.dead_delay
        return float(self.limits.stuck_readings or 0) if verdict == Verdict.STUCK else 0.0

    def says(self) -> list[str]:
        """Return sentences on the faults: which faults there are, when each began, and what to do."""
        lost = sum(found.readings for verdict, found in self.found.items() if verdict in _COUNTED_AS_LOST)
        lines = fault_messages(self.found, self.limits, self.step_s)
        if lost > MOST_LOST * self.rows:
            lines.insert(0, f"{lost} of {self.rows} readings are clipped or stuck: between them the signal is a guess.")
        return [*self._repeats(), *lines, *self.changes()]

    def changes(self) -> list[str]:
        """Return a sentence on a change of the noise; an empty list without a change."""
        return noise_change_message(self.monitor.history.change(), self.step_s)

    def advice(self) -> tuple[str, ...]:
        """Return what to do about the faults."""
        return (*(ADVICE[verdict] for verdict in sorted(self.found)), *self.changes())


class HealthyReadings(NamedTuple):
    """The readings of a channel to tune on, and the limits that were found from them."""

    readings: Floats  # (N,) NaN where missing, impossible, clipped, stuck or a gross outlier
    outliers: Floats  # (N,) the gross outliers, clipped to the plausible range; NaN elsewhere
    limits: LimitsRecipe | None


def find_healthy(z: Floats, elapsed: Floats, step_s: float, *, causal: bool = False) -> HealthyReadings:
    """Find the limits of a channel, and leave out its faulty readings.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit; NaN where missing.
    elapsed : (N,) float array
        Steps since the previous row.
    step_s : float
        One step, in seconds.
    causal : bool
        Whether to find gross outliers from earlier readings only, as a causal filter does; this finds fewer of them.

    Returns
    -------
    HealthyReadings
        The readings (the same array if all are usable), the outliers and the limits.
    """
    limits = find_limits(z, elapsed, FALSE_ALARMS_PER_HOUR, step_s)
    codes = Faults(limits if causal else limits._replace(outliers=limits.outliers.without_neighbours)).push(z, elapsed)
    rule = limits.outliers
    if not causal:
        possible = np.where(np.isfinite(z) & (np.abs(z) <= limits.largest) & (z != rule.blank), z, np.nan)
        outlier_codes = verdicts_from_neighbours(possible, rule, stuck_at_once(limits))
        codes[(outlier_codes == Verdict.OUTLIER) & ~LOST[codes]] = Verdict.OUTLIER
        codes[outlier_codes == Verdict.STUCK] = Verdict.STUCK
    usable = ~LOST[codes] & (z != rule.blank)
    outliers = np.where((codes == Verdict.OUTLIER) & (z != rule.blank), np.clip(z, rule.low, rule.high), np.nan)
    return HealthyReadings(z if usable.all() else np.where(usable, z, np.nan), outliers, limits_recipe(limits))


class SensorWatch:
    """A check of one channel's readings before the filter: it passes usable readings and gives faulty ones a verdict.

    It also detects, from the filter's innovations, a change of the noise and, if the recipe has thresholds, drift and a
    dead sensor.

    Parameters
    ----------
    entry : LimitsRecipe or None
        Limits of the channel.
    step_s : float
        One step, in seconds.
    has_innovations : bool
        Whether `add_innovations` will be called for all rows.
    ahead : int
        Number of later rows that the outlier test uses; with 0 it uses earlier readings only.

    Attributes
    ----------
    rows : int
        Number of rows so far.
    monitor : InnovationMonitor
        Monitor that detects faults from the innovations.
    """

    def __init__(
        self, entry: LimitsRecipe | None, step_s: float, *, has_innovations: bool = True, ahead: int = 0
    ) -> None:
        limits = limits_of(entry)
        self._ahead = LookAhead(limits, ahead) if ahead and limits.outliers.distance < np.inf else None
        if ahead:
            limits = limits._replace(outliers=limits.outliers.without_neighbours)
        self._faults, self.monitor = Faults(limits), InnovationMonitor(alarms_of(entry))
        self._has_innovations = has_innovations
        self._verdicts: Codes = np.empty(0, np.int8)  # of the rows that wait for their estimates
        self._alarms: Codes = np.empty(0, np.int8)  # of the rows that have innovations and wait for their estimates
        self._elapsed = np.empty(0)  # steps since the previous row, of the rows that wait for their innovations
        self._step_s, self.rows = step_s, 0

    def push(self, z: Floats, elapsed: Floats) -> tuple[Floats, Floats]:
        """Take readings (B,) and the steps since the previous row (B,).

        Returns
        -------
        (float array, float array)
            The readings of the next rows, NaN where no reading may enter the filter, and the steps since the previous
            row. Rows that wait for later rows are returned by a later call.
        """
        if self._ahead is None:
            return self._usable(z, elapsed, None), elapsed
        z, elapsed, outliers = self._ahead.push(z, elapsed)
        return self._usable(z, elapsed, outliers), elapsed

    def finish(self) -> tuple[Floats, Floats]:
        """Return the readings of the remaining rows, as `push` does."""
        if self._ahead is None:
            return np.empty(0), np.empty(0)
        z, elapsed, outliers = self._ahead.finish()
        return self._usable(z, elapsed, outliers), elapsed

    def _usable(self, z: Floats, elapsed: Floats, outliers: Codes | None) -> Floats:
        if not len(z):
            return z
        verdicts = self._faults.push(z, elapsed, outliers)
        self._verdicts = np.append(self._verdicts, verdicts)
        if self._has_innovations:
            self._elapsed = np.append(self._elapsed, elapsed)  # a copy: the caller may change `elapsed` later
        self.rows += len(z)
        return np.where(LOST[verdicts], np.nan, z) if verdicts.any() else z

    def set_history(self, before: History) -> None:
        """Set the history before the first row."""
        self._faults.set_history(before.rows, before.steps, before.least, before.most)
        self.monitor.set_history(before.readings, before.rows, before.steps)

    def add_innovations(self, innovations: Floats, innovation_sigma: Floats) -> None:
        """Take the innovations of the next rows (B,), and their expected standard deviations (B,)."""
        alarms = [self._alarms]
        for start in range(0, len(innovations), _PIECE):
            piece = slice(start, start + _PIECE)
            normalised = innovations[piece] / innovation_sigma[piece]
            elapsed, self._elapsed = self._elapsed[: len(normalised)], self._elapsed[len(normalised) :]
            alarms.append(self.monitor.push(normalised, elapsed))
        self._alarms = np.concatenate(alarms)

    def with_verdicts(self, rows: list[EstimatedRows]) -> list[EstimatedRows]:
        """Return the estimates of the next rows, with the verdicts of this check merged into those of the filter."""
        return [part._replace(verdicts=self._all_verdicts(part.verdicts)) for part in rows]

    def state_dict(self) -> dict[str, Any]:
        """Return the state as arrays."""
        waiting = {"watch_verdicts": self._verdicts, "watch_alarms": self._alarms, "watch_elapsed": self._elapsed}
        ahead = {} if self._ahead is None else self._ahead.state_dict()
        return self._faults.state_dict() | self.monitor.state_dict() | waiting | ahead

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the state that `state_dict` returned."""
        self._faults.load_state_dict(arrays)
        self.monitor.load_state_dict(arrays)
        self._verdicts, self._alarms = arrays["watch_verdicts"], arrays["watch_alarms"]
        self._elapsed = arrays["watch_elapsed"]
        if self._ahead is not None:
            self._ahead.load_state_dict(arrays)

    def comparable_state(self) -> dict[str, Any]:
        """Return the part of the state that later verdicts depend on, for comparison."""
        monitor = self.monitor.comparable_state() if self._has_innovations else {}
        return self._faults.comparable_state() | monitor

    def _all_verdicts(self, verdicts: Codes) -> Codes:
        rows = len(verdicts)
        before, self._verdicts = self._verdicts[:rows], self._verdicts[rows:]
        alarms, self._alarms = self._alarms[:rows], self._alarms[rows:]
        merged = merged_verdicts(verdicts, before)
        return np.where((merged == Verdict.USED) & (alarms > 0), alarms, merged) if alarms.any() else merged

    @property
    def findings(self) -> Findings:
        """Return the faults found so far."""
        return Findings(self._faults.limits, self._step_s, self.rows, self._faults.found, self.monitor)


def merged_verdicts(verdicts: Codes, before: Codes) -> Codes:
    """Merge verdicts (B,) of the filter with those from `before` the filter.

    A verdict of the filter replaces the earlier one only if it is `OVERRANGE`, `SPIKE` or `STEP`.
    """
    return np.where(_FROM_FILTER[verdicts], verdicts, before) if verdicts.any() else before
