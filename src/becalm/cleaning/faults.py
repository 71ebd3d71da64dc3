"""Faults of a sensor, on a channel's way: what is found leaves no trace in the signal but a verdict, and a sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from becalm.cleaning.recipe import LimitsRecipe
from becalm.core.arrays import Codes, Floats
from becalm.core.clock import GAP_STEPS
from becalm.core.faults import Faults, Found, said
from becalm.core.flow import Told
from becalm.core.limits import Limits, find_limits
from becalm.core.verdict import Verdict

FALSE_ALARMS_PER_HOUR = 1.0
"""Healthy stretches of an hour that may be called stuck; a small one trusts the sensor."""

MOST_LOST = 0.5
"""Share of the rows: a channel that is clipped or stuck in more of them hardly measures."""

_LOST = (Verdict.CLIPPED, Verdict.STUCK)
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
    return Healthy(SensorWatch(limits).push(z, elapsed), _told(limits))


def _told(limits: Limits) -> LimitsRecipe | None:
    """Write limits as a recipe does; None where only the time could be told of."""
    rails = [float(rail) if np.isfinite(rail) else None for rail in limits.rails]
    if rails == [None, None] and limits.stuck_readings is None:
        return None
    return LimitsRecipe(
        low=rails[0],
        high=rails[1],
        resolution=limits.resolution or None,
        stuck_readings=limits.stuck_readings,
        even_time=limits.even,
        gap_steps=None if limits.gap_steps == GAP_STEPS else limits.gap_steps,
    )


def limits_of(told: LimitsRecipe | None) -> Limits:
    """Return the limits of a recipe; where it has none, no reading is clipped or stuck, and no row late."""
    if told is None:
        return Limits(even=False)
    return Limits(
        -np.inf if told.low is None else told.low,
        np.inf if told.high is None else told.high,
        told.resolution or 0.0,
        told.stuck_readings,
        told.gap_steps or GAP_STEPS,
        bool(told.even_time),
    )


class SensorWatch:
    """Stands before a filter of one channel: lets only usable readings in, and knows what became of the others.

    Parameters
    ----------
    limits : Limits
        What the channel keeps to.
    """

    def __init__(self, limits: Limits) -> None:
        self._faults = Faults(limits)
        self._verdicts: Codes = np.empty(0, np.int8)  # of rows that the filter still holds
        self.rows = 0

    def push(self, z: Floats, elapsed: Floats) -> Floats:
        """Take readings (B,) and the steps before them; return them, NaN where none may enter the filter."""
        verdicts = self._faults.push(z, elapsed)
        self._verdicts = np.concatenate([self._verdicts, verdicts])
        self.rows += len(z)
        enters = _ENTERS[verdicts]
        return z if enters.all() else np.where(enters, z, np.nan)

    def named(self, told: list[Told]) -> list[Told]:
        """Return what a filter tells of the next rows, with what was wrong with their readings before it saw them."""
        return [part._replace(verdicts=self._beside(part.verdicts)) for part in told]

    def _beside(self, verdicts: Codes) -> Codes:
        before, self._verdicts = self._verdicts[: len(verdicts)], self._verdicts[len(verdicts) :]
        return np.where((verdicts == Verdict.SPIKE) | (verdicts == Verdict.STEP), verdicts, before)

    @property
    def found(self) -> Mapping[Verdict, Found]:
        """What is wrong with readings, or with their time; what is missing is no fault."""
        return {verdict: found for verdict, found in self._faults.found.items() if verdict != Verdict.MISSING}

    def faults(self, step_s: float) -> tuple[Fault, ...]:
        """Tell each fault, with when it came first."""
        stuck_s = (self._faults.stuck_delay or 0) * step_s
        return tuple(
            Fault(
                verdict.name.lower(),
                found.readings,
                found.first_row + 1,
                found.first_step * step_s,
                stuck_s if verdict == Verdict.STUCK else 0.0,
            )
            for verdict, found in sorted(self.found.items())
        )

    def says(self, step_s: float) -> list[str]:
        """Say what was found, when first, and what to do."""
        lost = sum(found.readings for verdict, found in self.found.items() if verdict in _LOST)
        warning = (
            [f"{lost} of {self.rows} readings are clipped or stuck: between them the signal is a guess."]
            if lost > MOST_LOST * self.rows
            else []
        )
        return [*warning, *said(self.found, self._faults.limits, step_s)]
