"""Faults of a sensor, on a channel's way: what is found leaves no trace in the signal but a verdict, and a sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.limits_entry import alarms_of, limits_of, written
from becalm.cleaning.recipe_parts import LimitsRecipe
from becalm.core.arrays import Codes, Floats
from becalm.core.filter.channel import History
from becalm.core.health.faults import FaultCount, Faults, said
from becalm.core.health.limits import Limits, find_limits, stuck_at_once
from becalm.core.health.look_ahead import LookAhead
from becalm.core.health.monitor import InnovationMonitor
from becalm.core.health.noise_change import said_of_change
from becalm.core.health.outlier_rule import beside_others
from becalm.core.rows import EstimatedRows
from becalm.core.verdict import ADVICE, LOST, Verdict
from becalm.native.scans import EVERY_REPEAT

FALSE_ALARMS_PER_HOUR = 1.0
"""Healthy stretches of an hour that may be called stuck; a *small* one trusts the sensor."""

MOST_LOST = 0.5
"""Share of the rows: a channel that is clipped or stuck in more of them hardly measures."""

_PIECE = 1 << 16  # rows whose arrays stay in the cache
_HARDLY_MEASURES = (Verdict.CLIPPED, Verdict.STUCK)
_FROM_FILTER = np.isin(list(Verdict), [Verdict.OVERRANGE, Verdict.SPIKE, Verdict.STEP])


@dataclass(frozen=True)
class Fault:
    """A fault of a sensor that was found in a channel.

    Attributes
    ----------
    what : str
        The verdict, in a word.
    readings : int
        How many met it.
    first_row : int
        The first of them, counted from 1.
    first_s : float
        When it came, in seconds after the first row.
    found_within_s : float
        How long such a fault lasts, at the most, until it is told; 0: its first reading tells.
    """

    what: str
    readings: int
    first_row: int
    first_s: float
    found_within_s: float


class Findings(NamedTuple):
    """What was found to be wrong with the sensor of one channel."""

    limits: Limits  # what its readings were held against
    step_s: float
    rows: int  # so far
    of_readings: dict[Verdict, FaultCount]  # what is wrong with readings, or with their times
    monitor: InnovationMonitor  # what is wrong with innovations

    @property
    def found(self) -> dict[Verdict, FaultCount]:
        """What is wrong with readings, with their time, or with innovations; what is missing is no fault."""
        told = (Verdict.MISSING, Verdict.STUCK) if self._holds else (Verdict.MISSING,)
        found = {verdict: one for verdict, one in self.of_readings.items() if verdict not in told}
        return found | self.monitor.found

    @property
    def _holds(self) -> bool:
        return self.limits.stuck_readings == EVERY_REPEAT

    def _said_of_repeats(self) -> list[str]:
        """Say how often a channel repeats a reading because no new one came."""
        found = self.of_readings.get(Verdict.STUCK)
        if not self._holds or found is None:
            return []
        if found.readings > MOST_LOST * self.rows:
            new = self.rows / (self.rows - found.readings)
            return [
                f"The sensor is slower than its log: a new reading comes every {new:.3g} rows on average; the rows"
                " between repeat it and count as missing."
            ]
        return [f"{found.readings} of {self.rows} rows only repeat the reading before and count as missing."]

    def faults(self) -> tuple[Fault, ...]:
        """Tell each fault, with when it came first."""
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
        """Return how many readings a fault lasts until it is told."""
        alarms = self.monitor.alarms
        if verdict in (Verdict.DRIFT, Verdict.DEAD):
            return alarms.drift_delay if verdict == Verdict.DRIFT else alarms.dead_delay
        return float(self.limits.stuck_readings or 0) if verdict == Verdict.STUCK else 0.0

    def says(self) -> list[str]:
        """Say what was found, when first, and what to do."""
        lost = sum(found.readings for verdict, found in self.found.items() if verdict in _HARDLY_MEASURES)
        told = said(self.found, self.limits, self.step_s)
        if lost > MOST_LOST * self.rows:
            told.insert(0, f"{lost} of {self.rows} readings are clipped or stuck: between them the signal is a guess.")
        return [*self._said_of_repeats(), *told, *self.changes()]

    def changes(self) -> list[str]:
        """Say from when on the noise was another."""
        return said_of_change(self.monitor.history.change(), self.step_s)

    def advice(self) -> tuple[str, ...]:
        """Say what to do about the faults that were found."""
        return (*(ADVICE[verdict] for verdict in sorted(self.found)), *self.changes())


class Healthy(NamedTuple):
    """Readings of a channel to tune on."""

    readings: Floats  # (N,) NaN where missing, impossible, clipped, stuck or a gross outlier
    outliers: Floats  # (N,) the gross outliers, held within what is plausible; NaN elsewhere
    limits: LimitsRecipe | None


def find_healthy(z: Floats, elapsed: Floats, step_s: float, *, causal: bool = False) -> Healthy:
    """Find what a channel keeps to, and leave out the readings that do not.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit; NaN where missing.
    elapsed : (N,) float array
        Steps since the row before.
    step_s : float
        One step, in seconds.
    causal : bool
        Whether gross outliers are those of a filter that waits for no later readings, which lets more of them in.

    Returns
    -------
    Healthy
        The readings as they came where all are usable.
    """
    limits = find_limits(z, elapsed, FALSE_ALARMS_PER_HOUR, step_s)
    codes = Faults(limits if causal else limits._replace(outliers=limits.outliers.without_neighbours)).push(z, elapsed)
    rule = limits.outliers
    if not causal:
        possible = np.where(np.isfinite(z) & (np.abs(z) <= limits.largest) & (z != rule.blank), z, np.nan)
        found = beside_others(possible, rule, stuck_at_once(limits))
        codes[(found == Verdict.OUTLIER) & ~LOST[codes]] = Verdict.OUTLIER
        codes[found == Verdict.STUCK] = Verdict.STUCK
    enters = ~LOST[codes] & (z != rule.blank)
    outliers = np.where((codes == Verdict.OUTLIER) & (z != rule.blank), np.clip(z, rule.low, rule.high), np.nan)
    return Healthy(z if enters.all() else np.where(enters, z, np.nan), outliers, written(limits))


class SensorWatch:
    """Stands before a filter of one channel: lets only usable readings in, and knows what became of the others.

    Shown the filter's innovations as well, it tells drift and death where the recipe says how, and a change of noise.

    Parameters
    ----------
    told : LimitsRecipe or None
        What the channel keeps to.
    step_s : float
        One step, in seconds.
    shown : bool
        Whether it will be shown innovations.
    ahead : int
        Later rows that each waits for, so that gross outliers are found by readings on both sides; 0: by those before.

    Attributes
    ----------
    rows : int
        Rows so far.
    monitor : InnovationMonitor
        Of the innovations.
    """

    def __init__(self, told: LimitsRecipe | None, step_s: float, *, shown: bool = True, ahead: int = 0) -> None:
        limits = limits_of(told)
        self._ahead = LookAhead(limits, ahead) if ahead and limits.outliers.distance < np.inf else None
        if ahead:
            limits = limits._replace(outliers=limits.outliers.without_neighbours)
        self._faults, self.monitor, self._shown = Faults(limits), InnovationMonitor(alarms_of(told)), shown
        self._verdicts: Codes = np.empty(0, np.int8)  # of rows that the filter still holds
        self._alarms: Codes = np.empty(0, np.int8)  # of rows whose innovations it has told before the rows themselves
        self._elapsed = np.empty(0)  # before rows without innovations yet
        self._step_s, self.rows = step_s, 0

    def push(self, z: Floats, elapsed: Floats) -> tuple[Floats, Floats]:
        """Take readings (B,) and the steps before them.

        Returns
        -------
        (float array, float array)
            The next readings, NaN where none may enter the filter, and the steps before them; fewer where rows wait.
        """
        if self._ahead is None:
            return self._usable(z, elapsed, None), elapsed
        z, elapsed, beside = self._ahead.push(z, elapsed)
        return self._usable(z, elapsed, beside), elapsed

    def finish(self) -> tuple[Floats, Floats]:
        """Return the readings that waited, as `push` does."""
        if self._ahead is None:
            return np.empty(0), np.empty(0)
        z, elapsed, beside = self._ahead.finish()
        return self._usable(z, elapsed, beside), elapsed

    def _usable(self, z: Floats, elapsed: Floats, beside: Codes | None) -> Floats:
        if not len(z):
            return z
        verdicts = self._faults.push(z, elapsed, beside)
        self._verdicts = np.append(self._verdicts, verdicts)
        if self._shown:
            self._elapsed = np.append(self._elapsed, elapsed)  # a copy: the caller may write into its own
        self.rows += len(z)
        return np.where(LOST[verdicts], np.nan, z) if verdicts.any() else z

    def begin_after(self, before: History) -> None:
        """Say what went before the rows that will come."""
        self._faults.begin_after(before.rows, before.steps, before.least, before.most)
        self.monitor.begin_after(before.readings, before.rows, before.steps)

    def look(self, innovations: Floats, innovation_sigma: Floats) -> None:
        """Take the innovations of the next rows (B,), and their expected standard deviations."""
        alarms = [self._alarms]
        for start in range(0, len(innovations), _PIECE):
            piece = slice(start, start + _PIECE)
            normalised = innovations[piece] / innovation_sigma[piece]
            elapsed, self._elapsed = self._elapsed[: len(normalised)], self._elapsed[len(normalised) :]
            alarms.append(self.monitor.push(normalised, elapsed))
        self._alarms = np.concatenate(alarms)

    def named(self, told: list[EstimatedRows]) -> list[EstimatedRows]:
        """Return what a filter tells of the next rows, with what else became of their readings."""
        return [part._replace(verdicts=self._beside(part.verdicts)) for part in told]

    def saved(self) -> dict[str, Any]:
        """Return what verdicts depend on, as arrays."""
        waiting = {"watch_verdicts": self._verdicts, "watch_alarms": self._alarms, "watch_elapsed": self._elapsed}
        ahead = {} if self._ahead is None else self._ahead.saved()
        return self._faults.saved() | self.monitor.saved() | waiting | ahead

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self._faults.restore(arrays)
        self.monitor.restore(arrays)
        self._verdicts, self._alarms = arrays["watch_verdicts"], arrays["watch_alarms"]
        self._elapsed = arrays["watch_elapsed"]
        if self._ahead is not None:
            self._ahead.restore(arrays)

    def comparable_state(self) -> dict[str, Any]:
        """Return what later verdicts depend on and nothing else, so that it can be compared."""
        return self._faults.comparable_state() | (self.monitor.comparable_state() if self._shown else {})

    def _beside(self, verdicts: Codes) -> Codes:
        rows = len(verdicts)
        before, self._verdicts = self._verdicts[:rows], self._verdicts[rows:]
        alarms, self._alarms = self._alarms[:rows], self._alarms[rows:]
        named = beside_filter(verdicts, before)
        return np.where((named == Verdict.USED) & (alarms > 0), alarms, named) if alarms.any() else named

    @property
    def findings(self) -> Findings:
        """What was found so far."""
        return Findings(self._faults.limits, self._step_s, self.rows, self._faults.found, self.monitor)


def beside_filter(verdicts: Codes, before: Codes) -> Codes:
    """Return what became of readings: what their filter says of them, (B,), and else what stood before it says."""
    return np.where(_FROM_FILTER[verdicts], verdicts, before) if verdicts.any() else before
