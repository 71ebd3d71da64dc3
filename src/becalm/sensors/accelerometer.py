"""Acceleration from what an accelerometer puts out: sensitivity, bias, and what each axis hears of the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Booleans, Floats, frozen
from becalm.errors import SensorError
from becalm.sensors.checks import finite_array, positive

CLIPPED = 0.999
"""Share of full scale from which a reading is clipped."""

_MOST_BITS = 64
_SINGULAR = 1e-6  # smallest over largest singular value: axes that do not span space


@dataclass(frozen=True, eq=False)
class Accelerometer:
    """The axes of one accelerometer: readings v = S a + b, and back a = S^-1 (v - b).

    Attributes
    ----------
    sensitivity : (m, m) float array
        S, in readings (V, or whatever comes) per unit of the result; row i is what axis i reads of each direction.
    bias : (m,) float array
        b, in readings: what is read without acceleration.

    Raises
    ------
    SensorError
        If shapes do not fit, a number is not finite, or S cannot be inverted.
    """

    sensitivity: Floats
    bias: Floats

    def __post_init__(self) -> None:
        """Check what came, and keep copies of our own."""
        size = len(np.atleast_1d(self.sensitivity))
        own = finite_array("sensitivity", self.sensitivity, (size, size))
        strengths = np.linalg.svd(own, compute_uv=False)
        if not strengths[-1] > _SINGULAR * strengths[0]:
            raise SensorError("sensitivity has axes that are alike, or hear nothing; give one direction for each axis.")
        object.__setattr__(self, "sensitivity", own)
        object.__setattr__(self, "bias", finite_array("bias", self.bias, (size,)))

    @classmethod
    def corrected_by(cls, correction: ArrayLike, bias: ArrayLike) -> Accelerometer:
        """Make the accelerometer of which S^-1 (m, m) is known, as `becalm.sensors.poses` finds it.

        Raises
        ------
        SensorError
            As the class, of `correction`.
        """
        size = len(np.atleast_1d(np.asarray(correction)))
        own = cls(finite_array("correction", correction, (size, size)), np.zeros(size)).sensitivity
        return cls(frozen(np.linalg.inv(own)), frozen(bias))

    def zeroed_at(self, reading: float) -> Accelerometer:
        """Return the same one whose every axis read this at 0."""
        return Accelerometer(self.sensitivity, np.full(len(self.bias), reading))

    def acceleration(self, readings: Floats) -> Floats:
        """Return the acceleration (n, m) of readings (n, m); NaN where an axis that it needs is NaN."""
        told, inverse = readings - self.bias, np.linalg.inv(self.sensitivity)
        needed = np.abs(inverse) > np.finfo(float).eps * np.abs(inverse).max()
        sums = [(told[:, need] * row[need]).sum(axis=1) for row, need in zip(inverse, needed, strict=True)]
        return np.column_stack(sums)  # no product of matrices: each row has the same bits, however many come


def sensitivity_matrix(sensitivities: ArrayLike, cross_axis_percent: ArrayLike | None = None) -> Floats:
    """Return S (m, m) from the figures of a sheet.

    Parameters
    ----------
    sensitivities : (m,) array_like
        Of each axis along itself, in readings per unit; negative where it is mounted the other way.
    cross_axis_percent : (m, m) array_like, optional
        What axis i (row) hears of direction j (column), in percent of its own sensitivity; the diagonal is not
        looked at. None: nothing.

    Raises
    ------
    SensorError
        If shapes do not fit, or a sensitivity is zero.

    Notes
    -----
    Many sheets tell one transverse percentage t without its direction. That is no matrix but an uncertainty:
    t / sqrt(2) of the acceleration across the axis.
    """
    size = len(np.atleast_1d(np.asarray(sensitivities)))
    along = finite_array("sensitivities", sensitivities, (size,))
    if not along.all():
        raise SensorError("A sensitivity is 0; give what each axis reads per unit, as 0.9856 for 985.6 mV/g.")
    shares = np.zeros((size, size)) if cross_axis_percent is None else np.asarray(cross_axis_percent)
    shares = finite_array("cross_axis_percent", shares, (size, size)) / 100
    return frozen(along[:, np.newaxis] * np.where(np.eye(size) > 0, 1.0, shares))


class FullScale(NamedTuple):
    """The least and the greatest that can be read, in readings."""

    low: float
    high: float

    def clipped(self, readings: Floats) -> Booleans:
        """Return which readings, of any shape, are beyond 0.999 of full scale, counted from its middle."""
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        return np.asarray(np.abs(readings - middle) >= CLIPPED * half)


def volts_per_count(span_v: float, bits: int) -> float:
    """Return what one count of a converter is, in volts.

    Parameters
    ----------
    span_v : float
        From its least to its greatest input, in volts: 10 for +-5 V.
    bits : int
        Of the converter.

    Raises
    ------
    SensorError
        If the span is not positive, or there are no bits from 1 to 64.
    """
    if isinstance(bits, bool) or bits not in range(1, _MOST_BITS + 1):
        raise SensorError(f"bits = {bits!r} is no resolution of a converter; give a whole number, as 16 or 24.")
    return positive("span_v", span_v, "10.0") / 2.0 ** int(bits)
