"""What a kind of exported filter is: how it is written, what it is held against, and what it may be off by."""

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
from becalm.export.vectors import Reference, Vector
from becalm.export.written import WrittenChannel

Span = tuple[float, float]

Opened = Callable[[], Reference]
"""Opens what a filter is held against, at the start."""

Raw = NDArray[np.generic]
"""Numbers of whatever type C takes."""

_SAME, _NEAR = 1e-12, 1e-5  # of the largest signal, or of what a filter is sure of
_THROWN_DB = 10.0


def apart(span: Span | None) -> float | None:
    """Return how far readings may lie from each other, and from 0 on either side, in unit; None where nobody said."""
    return None if span is None else 2 * max(map(abs, span))


class Kind(Protocol):
    """How a channel is written, and held against becalm."""

    @property
    def number(self) -> NumberType:
        """What it computes in."""
        ...

    @property
    def words(self) -> str:
        """What readings are in a file, in words."""
        ...

    @property
    def bits(self) -> str:
        """Type of C that has as many bits as a reading."""
        ...

    @property
    def told(self) -> str:
        """Type of C that holds an expected signal."""
        ...

    @property
    def bridges(self) -> bool:
        """Whether it goes on after missing readings as becalm does, with a covariance."""
        ...

    @property
    def promised_db(self) -> float:
        """How far the power of the difference from becalm is below that of the signal, in dB, at the least."""
        ...

    def write(self, design: Design, prefix: str, span: Span | None) -> WrittenChannel:
        """Write a filter; `span` is the least and the greatest reading, in unit."""
        ...

    def reference(self, recipe: ChannelRecipe, design: Design, written: WrittenChannel) -> Reference:
        """Return what it is held against, at the start."""
        ...

    def raw(self, readings: Floats, written: WrittenChannel) -> Raw:
        """Return readings (N,) in unit, NaN where missing, as numbers that C is given."""
        ...

    def in_unit(self, raw: Raw, written: WrittenChannel) -> Floats:
        """Return numbers (N,) that C was given, or told, in unit; NaN for a missing reading."""
        ...

    def counts(self, signal: Floats, written: WrittenChannel) -> Floats:
        """Return a signal (N,), in unit, in what C tells it in, not rounded."""
        ...

    def most_error(self, vector: Vector, design: Design, written: WrittenChannel, opened: Opened) -> float:
        """Return what a signal may be off by, in what C tells it in; `opened` opens what it is held against."""
        ...

    def most_power(self, vector: Vector, design: Design, most_error: float) -> float:
        """Return what the power of the difference may be, in parts of that of the signal."""
        ...


@dataclass(frozen=True)
class Floating:
    """What filters in floating point have in common.

    Attributes
    ----------
    number : NumberType
        What they compute in.
    """

    number: NumberType

    @property
    def bridges(self) -> bool:
        """Whether it goes on after missing readings as becalm does, with a covariance."""
        return True

    @property
    def promised_db(self) -> float:
        """How far the power of the difference from becalm is below that of the signal, in dB, at the least."""
        return 240.0 if self.number.is_double else 120.0

    @property
    def words(self) -> str:
        """What readings are in a file, in words."""
        return f"{self.number.name}s"

    @property
    def bits(self) -> str:
        """Type of C that has as many bits as a reading."""
        return "uint64_t" if self.number.is_double else "uint32_t"

    @property
    def told(self) -> str:
        """Type of C that holds an expected signal."""
        return "double"

    def raw(self, readings: Floats, written: WrittenChannel) -> Raw:
        """Return readings (N,) as numbers that C is given."""
        with np.errstate(over="ignore"):
            return readings.astype(self.number.dtype)

    def in_unit(self, raw: Raw, written: WrittenChannel) -> Floats:
        """Return numbers (N,) that C was given, or told, in unit."""
        return raw.astype(np.float64)

    def counts(self, signal: Floats, written: WrittenChannel) -> Floats:
        """Return a signal (N,) in what C tells it in: its unit."""
        return signal

    def most_power(self, vector: Vector, design: Design, most_error: float) -> float:
        """Return what the power of the difference may be, in parts of that of the signal.

        In float32 it is ten times what records keep to: golden vectors throw a filter about, and begin it anew. A
        signal that is smaller than what the filter is sure of counts as so large; one that is 0 is kept as it is.
        """
        allowed = 10 ** (-(self.promised_db - (0.0 if self.number.is_double else _THROWN_DB)) / 10)
        power = float(np.square(vector.signal).mean())
        return float(allowed * max(1.0, _sure_of(design) ** 2 / power)) if power > 0 else allowed

    def most_error(self, vector: Vector, design: Design, written: WrittenChannel, opened: Opened) -> float:
        """Return what a signal may be off by, in what C tells it in."""
        largest = float(np.abs(vector.signal).max())
        return (_SAME if self.number.is_double else _NEAR) * max(largest, _sure_of(design))


def _sure_of(design: Design) -> float:
    """Return the standard deviation of what a filter tells at best, in unit.

    Signals below it are nothing.
    """
    return design.settled_std if np.isfinite(design.settled_std) else design.noise_std
