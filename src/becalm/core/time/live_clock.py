"""The clock of a stream: true time between rows, where stamps come one after the other and none can be looked up later.

A file's clock is understood from all of its stamps (`core/time/clock`); a stream's is known beforehand, by its step,
and is followed: a stamp within a fiftieth of a step of where the sender's even grid leads is one step after the row
before, and any other is as far from it as it says.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Codes, Floats
from becalm.errors import ModelError, TimeError
from becalm.native.library import CONSTANTS
from becalm.native.scans import CLOCK, walk_stamps

__all__ = ["AGREEING", "FAR", "LATE", "REPEATED", "RESET", "TAKEN", "UNTIMED", "ClockReadings", "LiveClock"]

TAKEN, LATE, REPEATED, FAR, RESET, UNTIMED = (
    CONSTANTS[name] for name in ("TAKEN_STAMP", "LATE_STAMP", "REPEATED_STAMP", "FAR_STAMP", "CLOCK_RESET", "NO_STAMP")
)
"""What became of a row: taken; before or at the row before; far ahead; taken, though the clock jumped; no stamp."""

AGREEING = CONSTANTS["AGREEING"]
"""Stamps in a row, behind or far ahead of the clock, that ascend: then it is the clock that jumped."""

_SLACK, _ROUNDING = 0.02, 1.05  # of a step; of a last digit
_MANY_DIGITS, _HALF, _WHOLE = 50, 0.5, 1e-3  # last digits in a step
_DAY_S, _MANY_STEPS = 86400.0, 1000.0


class ClockReadings(NamedTuple):
    """What the stamps of some rows say."""

    elapsed: Floats  # (B,) steps since the row that was taken before; 0 of the first of all, and of rows not taken
    codes: Codes  # (B,) TAKEN or RESET of those to take; LATE, REPEATED, FAR, UNTIMED of those to leave out


class LiveClock:
    """Counts the steps between the rows of a stream.

    Parameters
    ----------
    step_s : float
        One step in seconds.
    resolution_s : float
        Last digit that the stamps are rounded to, in seconds; with a *small* one a stamp is believed to its own digits.

    Raises
    ------
    TimeError
        If the step is no positive number of seconds.
    """

    def __init__(self, step_s: float, resolution_s: float = 0.0) -> None:
        if not 0.0 < step_s < np.inf:
            raise TimeError(f"step_s = {step_s!r} is no time between two rows; give a positive number of seconds.")
        self._state = np.zeros((), CLOCK)
        self._state["step"], self._state["pace"] = step_s, 1.0
        digits = step_s / resolution_s if resolution_s > 0 else np.inf
        on_digits = digits > _MANY_DIGITS or (digits > _HALF and abs(digits - round(digits)) < _WHOLE)
        self._state["slack"] = _SLACK if on_digits else max(_SLACK, _ROUNDING / digits)
        self._state["coarse"] = float(digits < 2)
        self._state["farthest"] = max(_DAY_S, _MANY_STEPS * step_s)

    def passed(self, stamps_s: Floats, doubled: Booleans | None = None) -> ClockReadings:
        """Take the stamps (B,) of the next rows, in seconds; the result is the same for any blocks.

        `doubled` (B,) says which rows have the very readings of the row before, by default none.

        A stamp before the last is LATE, and one more than a day (or 1000 steps) after it FAR; eight such that ascend
        are believed, and the clock goes on from there (RESET): backwards as if one step had passed, forwards as far as
        it says. The same stamp again is REPEATED; where stamps are as coarse as the step, only if the readings are too.
        """
        stamps = np.ascontiguousarray(stamps_s, dtype=np.float64)
        told = ClockReadings(np.empty(len(stamps)), np.empty(len(stamps), np.int8))
        again = np.zeros(len(stamps), np.int8) if doubled is None else np.ascontiguousarray(doubled, np.int8)
        walk_stamps(self._state, stamps, again, *told)
        return told

    def opened(self) -> None:
        """Hear that the stream was away, here or there: its next stamp may be as late as it likes."""
        self._state["opened"] = 1.0

    @property
    def last_s(self) -> float:
        """The stamp that was taken last, in seconds; -inf before the first."""
        return float(self._state["last"]) if self._state["started"] else -np.inf

    @property
    def state(self) -> Floats:
        """All that moves, (11,), for a snapshot."""
        return self._state.reshape(1).view(np.float64).copy()

    @classmethod
    def resumed(cls, state: Floats) -> LiveClock:
        """Go on from what `state` returned.

        Raises
        ------
        ModelError
            If it is none.
        """
        fits = state.shape == (CLOCK.itemsize // 8,) and state.dtype == np.float64 and np.isfinite(state).all()
        kept = np.ascontiguousarray(state).view(CLOCK).reshape(()) if fits else np.zeros((), CLOCK)
        if kept["step"] <= 0:
            raise ModelError("This is no state of a stream's clock; pass what `LiveClock.state` returned.")
        clock = cls(float(kept["step"]))
        clock._state = kept.copy()
        return clock
