"""Specify an exported filter with a settled gain: compute in plain Python what its C code computes for each reading.

The filter equals `becalm.Online` if no reading is missing and the schedule of gains is exact. For a missing reading it
predicts, and does not change its gain, because it has no covariance. After `Design.coasts` missing readings in a row it
does not change its state any more, and starts anew with the next reading.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.health.faults import Faults
from becalm.core.health.limits import Limits
from becalm.core.reading_verdicts import Verdict
from becalm.export.design import Design
from becalm.export.schedule import Schedule
from becalm.export.vectors import STARTING


class SettledReference:
    """A reference for one channel with a settled gain.

    Parameters
    ----------
    design : Design
        The filter of the channel.
    schedule : Schedule
        The gains of the filter.
    largest : float
        Magnitude beyond which a value is overrange, in unit.

    Attributes
    ----------
    p : (n,) float array
        Predicted state for the next row, for readings minus `level`.
    level : float
        Level that is subtracted from readings, in unit.
    row : int
        Number of usable readings since the filter last started.
    missed : int
        Number of consecutive rows without a usable reading, at most `Design.coasts`.
    """

    def __init__(self, design: Design, schedule: Schedule, largest: float) -> None:
        self._design, self._opening = design, design.opening.weights
        self._gains, self._until = [*schedule.K, schedule.settled], np.cumsum(schedule.counts)
        limits = design.limits
        self._faults = Faults(Limits(limits.low, limits.high, stuck_readings=limits.stuck_readings, largest=largest))
        self.p, self.level, self.row, self.missed = np.zeros(design.states), 0.0, 0, 0

    def run(self, readings: Floats) -> tuple[Floats, Codes]:
        """Process readings (B,); return the signal (B,) and the codes (B,)."""
        codes = self._faults.push(readings, np.ones(len(readings)))
        rows = [self._step(reading, code) for reading, code in zip(readings.tolist(), codes.tolist(), strict=True)]
        signal, final = zip(*rows, strict=True) if rows else ((), ())
        return np.array(signal, np.float64), np.array(final, np.int8)

    def gap(self, rows: int) -> None:
        """Advance by `rows` rows without a reading."""
        for _ in range(min(rows, self._design.coasts)):
            self.coast()

    def _step(self, reading: float, code: int) -> tuple[float, int]:
        if code != Verdict.USED:
            return self.coast(), code
        if self.missed >= self._design.coasts:
            self.row = 0
        self.missed = 0
        if self.row < len(self._opening):
            return self._open(reading)
        return self._take(reading), Verdict.USED

    def coast(self) -> float:
        """Advance by a row without a reading; return the prediction for this row."""
        if self.row < len(self._opening):
            self.row, self.p = 0, np.zeros_like(self.p)
            return self.level
        signal = self.level + float(self._design.output @ self.p)
        if self.missed < self._design.coasts:
            self.p = self._design.model.F @ self.p
            self.missed += 1
        return signal

    def _open(self, reading: float) -> tuple[float, int]:
        """Process one of the first readings, which determine the state."""
        F, C = self._design.model.F, self._design.output
        if self.row == 0:
            self.level, self.p = reading, np.zeros_like(self.p)
        self.p = self.p + self._opening[self.row] * (reading - self.level)
        self.row += 1
        if self.row < len(self._opening):
            return reading, STARTING
        signal = self.level + float(C @ self.p)
        self.p = F @ self.p
        return signal, Verdict.USED

    def _take(self, reading: float) -> float:
        """Process a reading by equations (1), (3) and (6), from the predicted state."""
        F, H, C = self._design.model.F, self._design.model.H[0], self._design.output
        at = self.row - len(self._opening)
        K = self._gains[int(np.searchsorted(self._until, at, side="right"))]
        nu = reading - self.level - float(H @ self.p)
        x = self.p + K * nu
        self.p, self.row = F @ x, self.row + 1
        return self.level + float(C @ x)
