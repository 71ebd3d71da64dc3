"""Define a kind of exported filter: how it is written, its reference, and its largest permitted error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.export.design import Design
from becalm.export.number_type import NumberType
from becalm.export.shared_parts import WrittenChannel
from becalm.export.vectors import Reference, Vector

Span = tuple[float, float]
"""Least and greatest reading, in unit."""

NewReference = Callable[[], Reference]
"""Function that returns a new reference for a filter."""

Raw = NDArray[np.generic]
"""Array of numbers of the type that the C code takes and returns."""

# Permitted errors in double and in float, relative to the largest signal or to sigma, whichever is larger.
_SAME, _NEAR = 1e-12, 1e-5
_VECTORS_DB = 10.0  # dB by which golden vectors in float32 may miss the guaranteed ratio


def distance_bound(span: Span | None) -> float | None:
    """Return a bound on the distance of readings from each other and from 0, in unit; None if unknown."""
    return None if span is None else 2 * max(map(abs, span))


class Kind(Protocol):
    """A kind of exported filter: it writes a channel as C, and defines the comparison with becalm."""

    @property
    def number(self) -> NumberType:
        """Return the number type of readings and signals."""
        ...

    @property
    def words(self) -> str:
        """Return a description of the numbers in a file of readings."""
        ...

    @property
    def bits(self) -> str:
        """Return the unsigned C type with as many bits as a reading."""
        ...

    @property
    def expected_type(self) -> str:
        """Return the C type of an expected signal."""
        ...

    @property
    def has_covariance(self) -> bool:
        """Return whether the filter has a covariance, so that it treats missing readings as becalm does."""
        ...

    @property
    def promised_db(self) -> float:
        """Return the guaranteed ratio of the signal's power to that of the difference from becalm, in dB."""
        ...

    def write(self, design: Design, prefix: str, span: Span | None) -> WrittenChannel:
        """Write a filter as C; `span` is the least and the greatest reading, in unit."""
        ...

    def reference(self, recipe: ChannelRecipe, design: Design, written: WrittenChannel) -> Reference:
        """Return a new reference, with which the C filter is compared."""
        ...

    def raw(self, readings: Floats, written: WrittenChannel) -> Raw:
        """Return readings (N,) in unit, NaN where missing, as numbers that the C code takes."""
        ...

    def in_unit(self, raw: Raw, written: WrittenChannel) -> Floats:
        """Return numbers (N,) of the C code in unit; NaN for a missing reading."""
        ...

    def counts(self, signal: Floats, written: WrittenChannel) -> Floats:
        """Return a signal (N,), in unit, on the scale of the numbers of the C code, not rounded."""
        ...

    def most_error(self, vector: Vector, design: Design, written: WrittenChannel, new_reference: NewReference) -> float:
        """Return the largest permitted error of a vector's signal, on the scale of the numbers of the C code."""
        ...

    def most_power(self, vector: Vector, design: Design, most_error: float) -> float:
        """Return the largest permitted power of the difference, relative to the power of the signal."""
        ...


@dataclass(frozen=True)
class Floating:
    """The common part of filters in floating point.

    Attributes
    ----------
    number : NumberType
        Number type of readings and signals.
    """

    number: NumberType

    @property
    def has_covariance(self) -> bool:
        """Return whether the filter has a covariance, so that it treats missing readings as becalm does: True."""
        return True

    @property
    def promised_db(self) -> float:
        """Return the guaranteed ratio of the signal's power to that of the difference from becalm, in dB."""
        return 240.0 if self.number.is_double else 120.0

    @property
    def words(self) -> str:
        """Return a description of the numbers in a file of readings."""
        return f"{self.number.name}s"

    @property
    def bits(self) -> str:
        """Return the unsigned C type with as many bits as a reading."""
        return "uint64_t" if self.number.is_double else "uint32_t"

    @property
    def expected_type(self) -> str:
        """Return the C type of an expected signal."""
        return "double"

    def raw(self, readings: Floats, written: WrittenChannel) -> Raw:
        """Return readings (N,) as numbers that the C code takes."""
        with np.errstate(over="ignore"):
            return readings.astype(self.number.dtype)

    def in_unit(self, raw: Raw, written: WrittenChannel) -> Floats:
        """Return numbers (N,) of the C code in unit."""
        return raw.astype(np.float64)

    def counts(self, signal: Floats, written: WrittenChannel) -> Floats:
        """Return a signal (N,) unchanged, because the numbers of the C code are in its unit."""
        return signal

    def most_power(self, vector: Vector, design: Design, most_error: float) -> float:
        """Return the largest permitted power of the difference, relative to the power of the signal.

        In float32 it is ten times the power that is permitted for records, because golden vectors jump from the least
        to the greatest reading and restart the filter. A signal whose rms is below the filter's sigma counts as one
        with an rms of sigma; a signal that is 0 throughout does not.
        """
        allowed = 10 ** (-(self.promised_db - (0.0 if self.number.is_double else _VECTORS_DB)) / 10)
        power = float(np.square(vector.signal).mean())
        return float(allowed * max(1.0, _uncertainty(design) ** 2 / power)) if power > 0 else allowed

    def most_error(self, vector: Vector, design: Design, written: WrittenChannel, new_reference: NewReference) -> float:
        """Return the largest permitted error of a vector's signal, in unit."""
        largest = float(np.abs(vector.signal).max())
        return (_SAME if self.number.is_double else _NEAR) * max(largest, _uncertainty(design))


def _uncertainty(design: Design) -> float:
    """Return a filter's sigma in the steady state, in unit; without a steady state, the noise std of a reading.

    Smaller signals are insignificant.
    """
    return design.settled_std if np.isfinite(design.settled_std) else design.noise_std
