"""Export a filter with a settled gain in fixed point: readings and signal are counts of 31 bits and a sign."""

from __future__ import annotations

import numpy as np

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.core.health.faults import Faults
from becalm.errors import RecipeError
from becalm.export.design import Design
from becalm.export.fixed.text import GREATEST, Scale, count_limits_of, round_to_factors, schedule_in, write_fixed
from becalm.export.fixed.word_length import STATE_BITS, fit
from becalm.export.kind import NewReference, Raw, Span
from becalm.export.number_type import NumberType
from becalm.export.settled.reference import SettledReference
from becalm.export.shared_parts import WrittenChannel
from becalm.export.vectors import Reference, Vector

COUNT = NumberType("q31", "int32_t", "", 31, np.int32, float(GREATEST))
"""The number type of a reading in fixed point."""

_MISSING = -(1 << 31)  # INT32_MIN, the count of a missing reading
_GAIN = 2.0**-28  # error relative to the largest signal, from rounded gains (31 bits) over successive predictions
_NOISES = 6.0  # largest rounding noise, in standard deviations of the rounding noise


class FixedReference(SettledReference):
    """The specification of a filter in fixed point: it starts anew if a state exceeds its range in C.

    The weights of the first readings are rounded to 31 bits, as in C. If these readings hardly separate tones from a
    motion, large weights cancel each other, and their rounding errors amount to whole counts.

    Parameters
    ----------
    design : Design
        The filter of the channel.
    largest : float
        Magnitude beyond which a value is overrange, in unit.
    scale : Scale
        Scale of the counts.
    """

    def __init__(self, design: Design, largest: float, scale: Scale) -> None:
        schedule, limits = schedule_in(design), count_limits_of(design, scale)
        super().__init__(design, schedule, largest)
        low, high = scale.in_unit(limits.low), scale.in_unit(limits.high)
        self._faults = Faults(self._faults.limits._replace(low=low, high=high))
        point, _ = fit(design, schedule, scale.lsb)
        self._opening = round_to_factors(self._opening)
        self._ends = scale.in_unit(-GREATEST), scale.in_unit(GREATEST)
        self._middle, self._most = scale.offset, scale.lsb * 2.0 ** (STATE_BITS - np.array(point.states, np.float64))

    def coast(self) -> float:
        """Advance by a row without a reading; return the prediction for this row."""
        signal = super().coast()
        self._restart_if_out_of_range(signal)
        return signal

    def _step(self, reading: float, code: int) -> tuple[float, int]:
        signal, code = super()._step(reading, code)
        self._restart_if_out_of_range(signal)
        return signal, code

    def _restart_if_out_of_range(self, signal: float) -> None:
        """Start anew, with the signal as the level, if a state exceeds its range."""
        states = self.p + self._design.level_direction * (self.level - self._middle)
        if (np.abs(states) > self._most).any():
            self.row, self.p, self.level = 0, np.zeros_like(self.p), float(np.clip(signal, *self._ends))


class FixedPointFilter:
    """The kind of filter with a table of gains and then a settled gain, in fixed point."""

    @property
    def number(self) -> NumberType:
        """Return the number type of a reading."""
        return COUNT

    @property
    def words(self) -> str:
        """Return a description of the numbers in a file of readings."""
        return "int32_t counts"

    @property
    def bits(self) -> str:
        """Return the unsigned C type with as many bits as a reading."""
        return "uint32_t"

    @property
    def expected_type(self) -> str:
        """Return the C type of an expected signal."""
        return "double"

    @property
    def promised_db(self) -> float:
        """Return the guaranteed ratio of the signal's power to that of the difference from becalm, in dB."""
        return 90.0

    def most_power(self, vector: Vector, design: Design, most_error: float) -> float:
        """Return the largest permitted power of the difference, relative to that of the signal."""
        return float(10 ** (-self.promised_db / 10))

    @property
    def has_covariance(self) -> bool:
        """Return whether the filter has a covariance, so that it treats missing readings as becalm does: False."""
        return False

    def write(self, design: Design, prefix: str, span: Span | None) -> WrittenChannel:
        """Write a filter as C; `span` is the least and the greatest reading, in unit.

        Raises
        ------
        RecipeError
            If the range of readings is unknown, empty or too narrow, or too wide for the word length.
        """
        unit = design.unit or "the unit of its readings"
        if span is None:
            raise RecipeError(
                f"{design.name}: q31 needs the range of readings; give --range LOW:HIGH in {unit}, or low and"
                " high in [channel.limits]."
            )
        low, high = span
        if not (low < high and np.isfinite(high - low)):
            raise RecipeError(f"{design.name}: a range is LOW:HIGH, and {low:g} is not below {high:g}.")
        if (high - low) / 2.0**32 < np.spacing(max(abs(low), abs(high))):
            raise RecipeError(
                f"{design.name}: {low:.9g} to {high:.9g}{design.unit_after} is too narrow at that distance from 0 to be"
                " counted in 32 bits; give a wider --range, or subtract the middle from the readings."
            )
        return write_fixed(design, prefix, COUNT, span)

    def reference(self, recipe: ChannelRecipe, design: Design, written: WrittenChannel) -> Reference:
        """Return a new reference, with which the C filter is compared."""
        return FixedReference(design, written.largest, _scale(written))

    def raw(self, readings: Floats, written: WrittenChannel) -> Raw:
        """Return readings (N,) in unit, NaN where missing, as saturated counts; INT32_MIN where missing."""
        missing = np.isnan(readings)
        counts = np.rint(_scale(written).counts(np.where(missing, 0.0, readings)))
        return np.where(missing, _MISSING, counts).astype(np.int32)

    def in_unit(self, raw: Raw, written: WrittenChannel) -> Floats:
        """Return counts (N,) in unit; NaN for a missing reading."""
        scale, counts = _scale(written), raw.astype(np.float64)
        return np.where(counts == _MISSING, np.nan, scale.offset + scale.lsb * counts)

    def counts(self, signal: Floats, written: WrittenChannel) -> Floats:
        """Return a signal (N,), in unit, as the C code returns it: in whole, saturated counts."""
        return np.rint(_scale(written).counts(signal))

    def most_error(self, vector: Vector, design: Design, written: WrittenChannel, new_reference: NewReference) -> float:
        """Return the largest permitted error of a signal, in counts, from rounded signals, gains and states."""
        assert written.word is not None, "the error of a word length is always computed for fixed point"
        lsb, largest = _scale(written).lsb, float(np.abs(self.counts(vector.signal, written)).max())
        return 1.0 + _GAIN * largest + (written.word.stall + _NOISES * written.word.noise) / lsb


def _scale(written: WrittenChannel) -> Scale:
    assert written.scale is not None, "a filter in fixed point has a scale"
    return Scale(*written.scale)
