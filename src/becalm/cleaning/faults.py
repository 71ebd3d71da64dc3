"""Faults of a sensor, on a channel's way: what is found leaves no trace in the signal but a verdict, and a sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.recipe_parts import LimitsRecipe
from becalm.core.arrays import Codes, Floats
from becalm.core.clock import GAP_STEPS
from becalm.core.faults import Faults, Found, said
from becalm.core.limits import Limits, find_limits
from becalm.core.monitor import NEVER, Alarms, InnovationMonitor
from becalm.core.noise_change import said_of_change
from becalm.core.standing import Before
from becalm.core.told import Told
from becalm.core.verdict import ADVICE, BEYOND_ANY_SENSOR, Verdict

FALSE_ALARMS_PER_HOUR = 1.0
"""Healthy stretches of an hour that may be called stuck; a *small* one trusts the sensor."""

MOST_LOST = 0.5
"""Share of the rows: a channel that is clipped or stuck in more of them hardly measures."""

_PIECE = 1 << 16  # rows whose arrays stay in the cache
_LOST = (Verdict.CLIPPED, Verdict.STUCK)
_FROM_FILTER = np.isin(list(Verdict), [Verdict.OVERRANGE, Verdict.SPIKE, Verdict.STEP])
_ENTERS = np.isin(list(Verdict), [Verdict.USED, Verdict.LATE, Verdict.REPEATED, Verdict.GAP])


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


class Healthy(NamedTuple):
    """Readings of a channel to tune on."""

    readings: Floats  # (N,) NaN where missing, impossible, clipped or stuck
    limits: LimitsRecipe | None


def find_healthy(z: Floats, elapsed: Floats, step_s: float) -> Healthy:
    """Find what a channel keeps to, and leave out the readings that do not.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit; NaN where missing.
    elapsed : (N,) float array
        Steps since the row before.
    step_s : float
        One step, in seconds.

    Returns
    -------
    Healthy
        The readings as they came where all are usable.
    """
    limits = find_limits(z, elapsed, FALSE_ALARMS_PER_HOUR, step_s)
    codes = Faults(limits).push(z, elapsed)
    enters = _ENTERS[codes]
    return Healthy(z if enters.all() else np.where(enters, z, np.nan), _told(limits))


def _told(limits: Limits) -> LimitsRecipe | None:
    """Write limits as a recipe does; None where only the time could be told of."""
    rails = [float(rail) if np.isfinite(rail) else None for rail in limits.rails]
    largest = limits.largest if limits.largest < BEYOND_ANY_SENSOR else None
    if rails == [None, None] and limits.stuck_readings is None and largest is None:
        return None
    return LimitsRecipe(
        low=rails[0],
        high=rails[1],
        resolution=limits.resolution or None,
        stuck_readings=limits.stuck_readings,
        even_time=limits.even,
        gap_steps=None if limits.gap_steps == GAP_STEPS else limits.gap_steps,
        largest=largest,
    )


def limits_of(told: LimitsRecipe | None) -> Limits:
    """Return the limits of a recipe; where it has none, no reading is clipped or stuck, and no row late."""
    if told is None:
        return Limits(even=False)
    return Limits(
        low=-np.inf if told.low is None else told.low,
        high=np.inf if told.high is None else told.high,
        resolution=told.resolution or 0.0,
        stuck_readings=told.stuck_readings,
        gap_steps=told.gap_steps or GAP_STEPS,
        even=bool(told.even_time),
        largest=told.largest or BEYOND_ANY_SENSOR,
    )


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

    Attributes
    ----------
    rows : int
        Rows so far.
    monitor : InnovationMonitor
        Of the innovations.
    """

    def __init__(self, told: LimitsRecipe | None, step_s: float, *, shown: bool = True) -> None:
        self._faults, self.monitor, self._shown = Faults(limits_of(told)), InnovationMonitor(alarms_of(told)), shown
        self._verdicts: Codes = np.empty(0, np.int8)  # of rows that the filter still holds
        self._alarms: Codes = np.empty(0, np.int8)  # of rows whose innovations it has told before the rows themselves
        self._elapsed = np.empty(0)  # before rows without innovations yet
        self._step_s, self.rows = step_s, 0

    @property
    def stuck(self) -> int:
        """How many equal readings in a row are called stuck; 0: none are."""
        return self._faults.limits.stuck_readings or 0

    def push(self, z: Floats, elapsed: Floats) -> Floats:
        """Take readings (B,) and the steps before them; return them, NaN where none may enter the filter."""
        if not len(z):
            return z
        verdicts = self._faults.push(z, elapsed)
        self._verdicts = np.append(self._verdicts, verdicts)
        if self._shown:
            self._elapsed = np.append(self._elapsed, elapsed)  # a copy: the caller may write into its own
        self.rows += len(z)
        return np.where(_ENTERS[verdicts], z, np.nan) if verdicts.any() else z

    def begin_after(self, before: Before) -> None:
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

    def named(self, told: list[Told]) -> list[Told]:
        """Return what a filter tells of the next rows, with what else became of their readings."""
        return [part._replace(verdicts=self._beside(part.verdicts)) for part in told]

    def saved(self) -> dict[str, Any]:
        """Return what verdicts depend on, as arrays."""
        waiting = {"watch_verdicts": self._verdicts, "watch_alarms": self._alarms, "watch_elapsed": self._elapsed}
        return self._faults.saved() | self.monitor.saved() | waiting

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self._faults.restore(arrays)
        self.monitor.restore(arrays)
        self._verdicts, self._alarms = arrays["watch_verdicts"], arrays["watch_alarms"]
        self._elapsed = arrays["watch_elapsed"]

    def _beside(self, verdicts: Codes) -> Codes:
        rows = len(verdicts)
        before, self._verdicts = self._verdicts[:rows], self._verdicts[rows:]
        alarms, self._alarms = self._alarms[:rows], self._alarms[rows:]
        named = beside_filter(verdicts, before)
        return np.where((named == Verdict.USED) & (alarms > 0), alarms, named) if alarms.any() else named

    @property
    def found(self) -> dict[Verdict, Found]:
        """What is wrong with readings, with their time, or with innovations; what is missing is no fault."""
        found = {verdict: one for verdict, one in self._faults.found.items() if verdict != Verdict.MISSING}
        return found | self.monitor.found

    def faults(self) -> tuple[Fault, ...]:
        """Tell each fault, with when it came first."""
        return tuple(
            Fault(
                verdict.name.lower(),
                found.readings,
                found.first_row + 1,
                found.first_step * self._step_s,
                self._delay(verdict) * self._step_s,
            )
            for verdict, found in sorted(self.found.items())
        )

    def _delay(self, verdict: Verdict) -> float:
        """Return how many readings a fault lasts until it is told."""
        alarms = self.monitor.alarms
        if verdict in (Verdict.DRIFT, Verdict.DEAD):
            return alarms.drift_delay if verdict == Verdict.DRIFT else alarms.dead_delay
        return float(self._faults.stuck_delay or 0) if verdict == Verdict.STUCK else 0.0

    def says(self) -> list[str]:
        """Say what was found, when first, and what to do."""
        lost = sum(found.readings for verdict, found in self.found.items() if verdict in _LOST)
        told = said(self.found, self._faults.limits, self._step_s)
        if lost > MOST_LOST * self.rows:
            told.insert(0, f"{lost} of {self.rows} readings are clipped or stuck: between them the signal is a guess.")
        return [*told, *self.changes()]

    def changes(self) -> list[str]:
        """Say from when on the noise was another."""
        return said_of_change(self.monitor.history.change(), self._step_s)

    def advice(self) -> tuple[str, ...]:
        """Say what to do about the faults that were found."""
        return (*(ADVICE[verdict] for verdict in sorted(self.found)), *self.changes())


def beside_filter(verdicts: Codes, before: Codes) -> Codes:
    """Return what became of readings: what their filter says of them, (B,), and else what stood before it says."""
    return np.where(_FROM_FILTER[verdicts], verdicts, before) if verdicts.any() else before


def alarms_of(told: LimitsRecipe | None) -> Alarms:
    """Return when a channel drifts or is dead; never where the recipe does not say."""
    drift = None if told is None else told.drift_threshold
    dead = None if told is None else told.dead_variance
    return Alarms(NEVER if drift is None else drift, 0.0, np.inf, dead or 0.0)
