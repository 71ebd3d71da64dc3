"""A settled gain after a table of gains, in fixed point: readings and signal are counts of 31 bits and a sign."""

from __future__ import annotations

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.core.health.faults import Faults
from becalm.errors import RecipeError
from becalm.export.design import Design
from becalm.export.fixed.text import GREATEST, Scale, kept_of, rails_of, schedule_in, written_fixed
from becalm.export.fixed.word_length import STATE_BITS, fit
from becalm.export.kind import Opened, Raw, Span
from becalm.export.number_type import NumberType
from becalm.export.settled.reference import SettledReference
from becalm.export.vectors import Reference, Vector
from becalm.export.written import WrittenChannel

COUNT = NumberType("q31", "int32_t", "", 31, np.int32, float(GREATEST))
"""A reading in fixed point."""

_MISSING = -(1 << 31)
_GAIN = 2.0**-28  # of a signal: gains have 31 bits, and what coasts grows by what they lack
_NOISES = 6.0  # standard deviations of what rounding adds, that nothing exceeds


class FixedReference(SettledReference):
    """The specification of a filter in fixed point: it begins anew where a state leaves the range that C has for it.

    The weights of the first readings are those of 31 bits: where these hardly tell tones from a motion, weights are
    large, cancel, and turn their last digits into counts.

    Parameters
    ----------
    design : Design
        Its filter.
    largest : float
        Magnitude beyond which a value is no reading, in unit.
    scale : Scale
        What counts are.
    """

    def __init__(self, design: Design, largest: float, scale: Scale) -> None:
        schedule, rails = schedule_in(design), rails_of(design, scale)
        super().__init__(design, schedule, largest)
        low, high = scale.in_unit(rails.low), scale.in_unit(rails.high)
        self._faults = Faults(self._faults.limits._replace(low=low, high=high))
        point, _ = fit(design, schedule, scale.lsb)
        self._opening = kept_of(self._opening)
        self._ends = scale.in_unit(-GREATEST), scale.in_unit(GREATEST)
        self._middle, self._most = scale.offset, scale.lsb * 2.0 ** (STATE_BITS - np.array(point.states, np.float64))

    def coast(self) -> float:
        """Go on for a row without a reading; return what was predicted for it."""
        signal = super().coast()
        self._watch(signal)
        return signal

    def _step(self, reading: float, code: int) -> tuple[float, int]:
        signal, became = super()._step(reading, code)
        self._watch(signal)
        return signal, became

    def _watch(self, signal: float) -> None:
        """Begin anew where a state is out of its range; until then what was told last is told."""
        states = self.p + self._design.level_direction * (self.level - self._middle)
        if (np.abs(states) > self._most).any():
            self.row, self.p, self.level = 0, np.zeros_like(self.p), float(np.clip(signal, *self._ends))


class FixedPointFilter:
    """A settled gain after a table of gains, in fixed point."""

    @property
    def number(self) -> NumberType:
        """What a reading is."""
        return COUNT

    @property
    def words(self) -> str:
        """What readings are in a file, in words."""
        return "int32_t counts"

    @property
    def bits(self) -> str:
        """Type of C that has as many bits as a reading."""
        return "uint32_t"

    @property
    def told(self) -> str:
        """Type of C that holds an expected signal."""
        return "double"

    @property
    def promised_db(self) -> float:
        """How far the power of the difference from becalm is below that of the signal, in dB, at the least."""
        return 90.0

    def most_power(self, vector: Vector, design: Design, most_error: float) -> float:
        """Return what the power of the difference may be, in parts of that of the signal."""
        return float(10 ** (-self.promised_db / 10))

    @property
    def bridges(self) -> bool:
        """Whether it goes on after missing readings as becalm does: it keeps its gain."""
        return False

    def write(self, design: Design, prefix: str, span: Span | None) -> WrittenChannel:
        """Write a filter; `span` is the least and the greatest reading, in unit."""
        unit = design.unit or "the unit of its readings"
        if span is None:
            raise RecipeError(
                f"{design.name}: q31 needs to know how far readings reach; give --range LOW:HIGH in {unit}, or low and"
                " high in [channel.limits]."
            )
        low, high = span
        if not (low < high and np.isfinite(high - low)):
            raise RecipeError(f"{design.name}: a range goes from low to high, and {low:g} is not below {high:g}.")
        if (high - low) / 2.0**32 < np.spacing(max(abs(low), abs(high))):
            raise RecipeError(
                f"{design.name}: {low:.9g} to {high:.9g}{design.unit_after} is too little so far from 0 to be counted"
                " in 32 bits; give a wider --range, or take the middle off the readings."
            )
        return written_fixed(design, prefix, COUNT, span)

    def reference(self, recipe: ChannelRecipe, design: Design, written: WrittenChannel) -> Reference:
        """Return what it is held against, at the start."""
        return FixedReference(design, written.largest, _scale(written))

    def raw(self, readings: Floats, written: WrittenChannel) -> Raw:
        """Return readings (N,) in unit, NaN where missing, as counts: INT32_MIN where missing, saturated beyond."""
        missing = np.isnan(readings)
        counts = np.rint(_scale(written).counts(np.where(missing, 0.0, readings)))
        return np.where(missing, _MISSING, counts).astype(np.int32)

    def in_unit(self, raw: Raw, written: WrittenChannel) -> Floats:
        """Return counts (N,) in unit; NaN for a missing reading."""
        scale, counts = _scale(written), raw.astype(np.float64)
        return np.where(counts == _MISSING, np.nan, scale.offset + scale.lsb * counts)

    def counts(self, signal: Floats, written: WrittenChannel) -> Floats:
        """Return a signal (N,), in unit, as C tells it: in whole counts, saturated."""
        return np.rint(_scale(written).counts(signal))

    def most_error(self, vector: Vector, design: Design, written: WrittenChannel, opened: Opened) -> float:
        """Return what a signal may be off by, in counts: one that is rounded the other way, and what states cost."""
        assert written.word is not None, "what fixed point costs is computed"
        lsb, largest = _scale(written).lsb, float(np.abs(self.counts(vector.signal, written)).max())
        return 1.0 + _GAIN * largest + (written.word.stall + _NOISES * written.word.noise) / lsb


def _scale(written: WrittenChannel) -> Scale:
    assert written.scale is not None, "a filter in fixed point has a scale"
    return Scale(*written.scale)
