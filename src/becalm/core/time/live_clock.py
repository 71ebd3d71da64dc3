"""The clock of a stream: it computes the time between rows as stamps arrive, without later stamps.

The clock of a file uses all stamps (`core/time/clock`). The step of a stream is known in advance, and the clock follows
the stamps. If a stamp lies on the sender's even grid, to a fiftieth of a step or to the rounding of coarse stamps, the
elapsed time is a whole number of steps; otherwise it is the actual difference of stamps.
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
"""Codes of rows: used; earlier than the last row; equal to the last row; far ahead; used after a jump of the clock;
without a stamp."""

AGREEING = CONSTANTS["AGREEING"]
"""After this many ascending stamps in a row that are earlier than the last row, or far ahead, the clock has jumped."""

_SLACK, _ROUNDING = 0.02, 1.05  # largest distance from the grid: in steps, and in last digits of coarse stamps
_MANY_DIGITS, _HALF, _WHOLE = 50, 0.5, 1e-3  # last digits per step: above 50, or above 0.5 and whole to 1e-3
_DAY_S, _MANY_STEPS = 86400.0, 1000.0  # a stamp farther ahead than both is FAR


class ClockReadings(NamedTuple):
    """Elapsed steps and codes of B rows."""

    elapsed: Floats  # (B,) steps since the last used row; 0 for the very first row and for rows that are not used
    codes: Codes  # (B,) TAKEN or RESET for rows to use; LATE, REPEATED, FAR or UNTIMED for rows to drop


class LiveClock:
    """A counter of the steps between the rows of a stream.

    Parameters
    ----------
    step_s : float
        One step, in seconds.
    resolution_s : float
        Last digit that the stamps are rounded to, in seconds; a *small* one trusts each stamp more exactly.

    Raises
    ------
    TimeError
        If the step is not a positive number of seconds.
    """

    def __init__(self, step_s: float, resolution_s: float = 0.0) -> None:
        if not 0.0 < step_s < np.inf:
            raise TimeError(f"step_s = {step_s!r} is not a time between two rows; give a positive number of seconds.")
        self._state = np.zeros((), CLOCK)
        self._state["step"], self._state["pace"] = step_s, 1.0
        digits = step_s / resolution_s if resolution_s > 0 else np.inf
        on_digits = digits > _MANY_DIGITS or (digits > _HALF and abs(digits - round(digits)) < _WHOLE)
        self._state["slack"] = _SLACK if on_digits else max(_SLACK, _ROUNDING / digits)
        self._state["coarse"] = float(digits < 2)
        self._state["farthest"] = max(_DAY_S, _MANY_STEPS * step_s)

    def process_stamps(self, stamps_s: Floats, doubled: Booleans | None = None) -> ClockReadings:
        """Process the stamps (B,) of the next rows, in seconds; the result does not depend on the block size.

        `doubled` (B,) marks rows whose readings equal those of the previous row; by default there are no such rows.

        A stamp before the last used one is LATE. A stamp more than a day (or 1000 steps, if longer) after it is FAR.
        The last of eight such stamps in ascending order is RESET, and the clock continues from it: a jump backwards
        counts as one step, a jump forwards counts in full. A stamp equal to the last one is REPEATED; if the last digit
        of stamps is more than half a step, this also requires equal readings.
        """
        stamps = np.ascontiguousarray(stamps_s, dtype=np.float64)
        result = ClockReadings(np.empty(len(stamps)), np.empty(len(stamps), np.int8))
        equal = np.zeros(len(stamps), np.int8) if doubled is None else np.ascontiguousarray(doubled, np.int8)
        walk_stamps(self._state, stamps, equal, *result)
        return result

    def mark_interruption(self) -> None:
        """Note that the stream was interrupted, so that its next stamp may be any time later."""
        self._state["opened"] = 1.0

    @property
    def last_s(self) -> float:
        """Return the last stamp that was used, in seconds; -inf before the first."""
        return float(self._state["last"]) if self._state["started"] else -np.inf

    @property
    def state(self) -> Floats:
        """Return a copy of the state, (11,), for a snapshot."""
        return self._state.reshape(1).view(np.float64).copy()

    @classmethod
    def from_state(cls, state: Floats) -> LiveClock:
        """Return a clock that continues from a state that `state` returned.

        Raises
        ------
        ModelError
            If `state` is not such a state.
        """
        fits = state.shape == (CLOCK.itemsize // 8,) and state.dtype == np.float64 and np.isfinite(state).all()
        restored = np.ascontiguousarray(state).view(CLOCK).reshape(()) if fits else np.zeros((), CLOCK)
        if restored["step"] <= 0:
            raise ModelError("This is not the state of a stream's clock; pass what `LiveClock.state` returned.")
        clock = cls(float(restored["step"]))
        clock._state = restored.copy()
        return clock
