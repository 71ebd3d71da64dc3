"""What an exported filter with a full covariance is held against: becalm's own stream, with C's words around it.

They differ only where too few readings came for the state to be known. There C passes readings on; a reading that is
missing among them begins it anew, for which a new stream is begun here. Where the stream's own rounding is more than
a part of what C may be off by, its signal is told with more digits; see `full/extended.py`.
"""

from __future__ import annotations

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.stream import StreamCleaner
from becalm.core.arrays import Codes, Floats
from becalm.core.faults import Faults
from becalm.core.limits import Limits
from becalm.core.verdict import Verdict
from becalm.export.design import Design
from becalm.export.full.extended import Extended
from becalm.export.vectors import STARTING

_AT_ONCE = 1 << 16  # rows of a gap that go one by one; so many more go as one
_ROUNDED = 2e-13  # of the largest signal: more of becalm's own rounding would be most of what C may be off by
_OF_GATE = (Verdict.SPIKE, Verdict.STEP)


class FullReference:
    """One channel.

    Parameters
    ----------
    recipe : ChannelRecipe
        Its filter and gate; what watches the sensor, and what only widens sigma, is left out.
    design : Design
        The same in numbers.
    largest : float
        Magnitude beyond which a value is no reading, in unit.

    Attributes
    ----------
    level : float
        The first reading since the last start, in unit; 0 before it. It is told while nothing is known.
    opened : int
        How many of the first readings came.
    missed : int
        Rows without a usable reading, one after the other.
    """

    def __init__(self, recipe: ChannelRecipe, design: Design, largest: float) -> None:
        bare = {"limits": None, "calibration": None, "timing": None, "tuning_spread": 0.0, "fill": True}
        self._recipe = Recipe(tuned_on=Origin(rate_hz=1 / design.step_s), channel=(recipe.model_copy(update=bare),))
        self._design, self._first = design, len(design.opening.weights)
        limits = design.limits
        self._faults = Faults(Limits(limits.low, limits.high, stuck_readings=limits.stuck_readings, largest=largest))
        self._stream = self._begun()
        self._gathered: list[float] = []
        self._extended: Extended | None = None
        self.level, self.opened, self.missed = 0.0, 0, 0

    def run(self, readings: Floats) -> tuple[Floats, Codes]:
        """Take readings (B,); return the signal and what became of each."""
        signal, digits, codes = self.both(readings)
        rounded = np.abs(signal - digits).max(initial=0.0) > _ROUNDED * np.abs(signal).max(initial=0.0)
        return (digits if rounded else signal), codes

    def both(self, readings: Floats) -> tuple[Floats, Floats, Codes]:
        """Take readings (B,); return becalm's signal, the same with more digits, and what became of each."""
        codes = self._faults.push(readings, np.ones(len(readings)))
        usable = np.where(codes == Verdict.USED, readings, np.nan)
        signal, digits, row = np.empty(len(readings)), np.empty(len(readings)), 0
        while row < len(readings):
            if self._is_lost(usable[row]):
                self.opened = 0
            if self.opened < self._first:
                signal[row], digits[row], codes[row] = self._open(usable[row], codes[row])
                row += 1
            else:
                stop = self._carried(usable, row)
                signal[row:stop], digits[row:stop], verdicts = self._push(usable[row:stop])
                codes[row:stop] = np.where(np.isin(verdicts, _OF_GATE), verdicts, codes[row:stop])
                row = stop
        return signal, digits, codes

    def gap(self, rows: int) -> None:
        """Go on for some rows without a reading."""
        if rows and self.opened < self._first:
            self.opened = 0
            return
        single = min(rows, _AT_ONCE)
        self._push(np.full(single, np.nan))
        if rows > single:
            self._stream.push(np.full((1, 1), np.nan), np.full(1, float(rows - single)))
            if self._extended is not None:
                self._extended.leap(rows - single)
        self.missed += rows

    def _begun(self) -> StreamCleaner:
        return StreamCleaner(self._recipe, self._design.step_s)

    def _is_lost(self, reading: float) -> bool:
        """Whether a reading comes after a gap so long that it begins anew."""
        return not np.isnan(reading) and self.missed >= self._design.longest_gap

    def _carried(self, usable: Floats, row: int) -> int:
        """Count the rows since the last reading from one row on; return the row up to which the filter is carried."""
        while row < len(usable) and not self._is_lost(usable[row]):
            self.missed = self.missed + 1 if np.isnan(usable[row]) else 0
            row += 1
        return row

    def _open(self, reading: float, code: int) -> tuple[float, float, int]:
        """Take one of the readings that tell the state."""
        self.missed = 0
        if np.isnan(reading):
            self.opened = 0
            return self.level, self.level, code
        if self.opened == 0:
            self.level, self._stream, self._gathered, self._extended = reading, self._begun(), [], None
        signal, _, _ = self._push(np.array([reading]))
        self._gathered.append(reading)
        self.opened += 1
        if self.opened < self._first:
            return reading, reading, STARTING
        self._extended = Extended(self._design, np.array(self._gathered))
        return float(signal[0]), self._extended.signal, Verdict.USED

    def _push(self, usable: Floats) -> tuple[Floats, Floats, Codes]:
        """Take rows that go one by one; return becalm's signal, the same with more digits, and its verdicts."""
        told = self._stream.push(usable[:, np.newaxis], np.ones(len(usable)))
        signal, verdicts = told.signal[:, 0], told.verdicts[:, 0]
        return signal, self._extended.follow(usable, verdicts) if self._extended else signal, verdicts
