"""Define a kind of exported filter: how it is written, its reference, and its largest permitted error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from becalm.cleaning.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.export.design import Design
from becalm.export.number_type import NumberType
from becalm.export.shared_parts import WrittenChannel
from becalm.export.vectors import Reference, Vector

Span = tuple[float, float]
"""Least and greatest reading, in unit."""

Opened = Callable[[], Reference]
"""Function that returns a new reference of a filter."""

Raw = NDArray[np.generic]
"""Numbers of the type that the C code takes."""

_SAME, _NEAR = 1e-12, 1e-5  # permitted error in double and float, relative to the larger of largest signal and sigma
_THROWN_DB = 10.0  # by which golden vectors in float32 may miss the guaranteed ratio, in dB


def apart(span: Span | None) -> float | None:
    """Return a bound on the distance of readings from each other and from 0, in unit; None if unknown."""
    return None if span is None else 2 * max(map(abs, span))


class Kind(Protocol):
    """A kind of exported filter: how a channel is written and compared with becalm."""

    @property
    def number(self) -> NumberType:
        """Return the number type of its readings and signals."""
        ...

    @property
    def words(self) -> str:
        """Return what a file of its readings contains, in words."""
        ...

    @property
    def bits(self) -> str:
        """Return the C type with as many bits as a reading."""
        ...

    @property
    def expected_type(self) -> str:
        """Return the C type of an expected signal."""
        ...

    @property
    def bridges(self) -> bool:
        """Return whether it continues after missing readings as becalm does, with a covariance."""
        ...

    @property
    def promised_db(self) -> float:
        """Return the guaranteed power of the signal over that of the difference from becalm, in dB."""
        ...

    def write(self, design: Design, prefix: str, span: Span | None) -> WrittenChannel:
        """Write a filter as C; `span` is the least and the greatest reading, in unit."""
        ...

    def reference(self, recipe: ChannelRecipe, design: Design, written: WrittenChannel) -> Reference:
        """Return a new reference that the filter is compared with."""
        ...

    def raw(self, readings: Floats, written: WrittenChannel) -> Raw:
        """Return readings (N,) in unit, NaN where missing, as numbers that the C code takes."""
        ...

    def in_unit(self, raw: Raw, written: WrittenChannel) -> Floats:
        """Return numbers (N,) that the C code took or returned, in unit; NaN for a missing reading."""
        ...

    def counts(self, signal: Floats, written: WrittenChannel) -> Floats:
        """Return a signal (N,), in unit, in the numbers of the C code, not rounded."""
        ...

    def most_error(self, vector: Vector, design: Design, written: WrittenChannel, opened: Opened) -> float:
        """Return the largest permitted error of a signal, in numbers of the C code; `opened` returns a reference."""
        ...

    def most_power(self, vector: Vector, design: Design, most_error: float) -> float:
        """Return the largest permitted power of the difference, relative to that of the signal."""
        ...


@dataclass(frozen=True)
class Floating:
    """The common part of filters in floating point.

    Attributes
    ----------
    number : NumberType
        Number type of their readings and signals.
    """

    number: NumberType

    @property
    def bridges(self) -> bool:
        """Return whether it continues after missing readings as becalm does, with a covariance."""
        return True

    @property
    def promised_db(self) -> float:
        """Return the guaranteed power of the signal over that of the difference from becalm, in dB."""
        return 240.0 if self.number.is_double else 120.0

    @property
    def words(self) -> str:
        """Return what a file of its readings contains, in words."""
        return f"{self.number.name}s"

    @property
    def bits(self) -> str:
        """Return the C type with as many bits as a reading."""
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
        """Return numbers (N,) that the C code took or returned, in unit."""
        return raw.astype(np.float64)

    def counts(self, signal: Floats, written: WrittenChannel) -> Floats:
        """Return a signal (N,) in the numbers of the C code, which are in its unit."""
        return signal

    def most_power(self, vector: Vector, design: Design, most_error: float) -> float:
        """Return the largest permitted power of the difference, relative to that of the signal.

        In float32 it is ten times that for records, because golden vectors drive a filter from end to end and start it
        anew. A signal smaller than the filter's sigma counts as large as sigma; this does not apply to a signal of 0.
        """
        allowed = 10 ** (-(self.promised_db - (0.0 if self.number.is_double else _THROWN_DB)) / 10)
        power = float(np.square(vector.signal).mean())
        return float(allowed * max(1.0, _uncertainty(design) ** 2 / power)) if power > 0 else allowed

    def most_error(self, vector: Vector, design: Design, written: WrittenChannel, opened: Opened) -> float:
        """Return the largest permitted error of a signal, in the numbers of the C code."""
        largest = float(np.abs(vector.signal).max())
        return (_SAME if self.number.is_double else _NEAR) * max(largest, _uncertainty(design))


def _uncertainty(design: Design) -> float:
    """Return a filter's sigma in the steady state, in unit; without a steady state, the noise of a reading.

    Signals below it are insignificant.
    """
    return design.settled_std if np.isfinite(design.settled_std) else design.noise_std
