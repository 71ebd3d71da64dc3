"""Convert readings of an accelerometer to acceleration, with sensitivity, bias and cross-axis sensitivity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Booleans, Floats, frozen
from becalm.errors import SensorError
from becalm.sensors.checks import finite_array, positive

CLIPPED = 0.999
"""Fraction of full scale at and above which a reading counts as clipped."""

_MOST_BITS = 64  # highest resolution of a converter
_SINGULAR = 1e-6  # smallest over largest singular value, below which the axes do not span the space


@dataclass(frozen=True, eq=False)
class Accelerometer:
    """An accelerometer of m axes with readings v = S a + b: the acceleration is a = S^-1 (v - b).

    Attributes
    ----------
    sensitivity : (m, m) float array
        S, in the unit of readings (such as V) per unit of the result; row i is the sensitivity of axis i to each
        direction.
    bias : (m,) float array
        b, the readings without acceleration, in the unit of readings.

    Raises
    ------
    SensorError
        If shapes do not fit, a number is not finite, or S cannot be inverted.
    """

    sensitivity: Floats
    bias: Floats

    def __post_init__(self) -> None:
        """Check the values, and store read-only copies of them."""
        size = len(np.atleast_1d(self.sensitivity))
        own = finite_array("sensitivity", self.sensitivity, (size, size))
        strengths = np.linalg.svd(own, compute_uv=False)
        if not strengths[-1] > _SINGULAR * strengths[0]:
            raise SensorError("sensitivity has parallel axes or an axis that is 0; give one direction per axis.")
        object.__setattr__(self, "sensitivity", own)
        object.__setattr__(self, "bias", finite_array("bias", self.bias, (size,)))

    @classmethod
    def corrected_by(cls, correction: ArrayLike, bias: ArrayLike) -> Accelerometer:
        """Return the accelerometer with a given S^-1 (m, m), as `becalm.sensors.poses` computes it.

        Raises
        ------
        SensorError
            If shapes do not fit, a number is not finite, or `correction` cannot be inverted.
        """
        size = len(np.atleast_1d(np.asarray(correction)))
        own = cls(finite_array("correction", correction, (size, size)), np.zeros(size)).sensitivity
        return cls(frozen(np.linalg.inv(own)), frozen(bias))

    def zeroed_at(self, reading: float) -> Accelerometer:
        """Return a copy in which each axis gives this reading at zero acceleration."""
        return Accelerometer(self.sensitivity, np.full(len(self.bias), reading))

    def acceleration(self, readings: Floats) -> Floats:
        """Return the acceleration (n, m) from readings (n, m); NaN where the reading of a needed axis is NaN."""
        unbiased, inverse = readings - self.bias, np.linalg.inv(self.sensitivity)
        needed = np.abs(inverse) > np.finfo(float).eps * np.abs(inverse).max()
        sums = [(unbiased[:, need] * row[need]).sum(axis=1) for row, need in zip(inverse, needed, strict=True)]
        return np.column_stack(sums)  # without BLAS, so that the bits of a row do not depend on the number of rows


def sensitivity_matrix(sensitivities: ArrayLike, cross_axis_percent: ArrayLike | None = None) -> Floats:
    """Return S (m, m) from the figures of a data sheet.

    Parameters
    ----------
    sensitivities : (m,) array_like
        Sensitivity of each axis along itself, in readings per unit; negative if the axis is mounted in reverse.
    cross_axis_percent : (m, m) array_like, optional
        Sensitivity of axis i (row) to direction j (column), in percent of its own sensitivity; the diagonal is
        ignored. None means 0.

    Raises
    ------
    SensorError
        If shapes do not fit, a sensitivity is zero, or a number is not finite.

    Notes
    -----
    Many data sheets give one transverse percentage t without a direction. Such a figure does not give a
    matrix but an uncertainty: t / sqrt(2) of the acceleration across the axis.
    """
    size = len(np.atleast_1d(np.asarray(sensitivities)))
    along = finite_array("sensitivities", sensitivities, (size,))
    if not along.all():
        raise SensorError("A sensitivity is 0; give the reading of each axis per unit, such as 0.9856 for 985.6 mV/g.")
    shares = np.zeros((size, size)) if cross_axis_percent is None else np.asarray(cross_axis_percent)
    shares = finite_array("cross_axis_percent", shares, (size, size)) / 100
    return frozen(along[:, np.newaxis] * np.where(np.eye(size) > 0, 1.0, shares))


class FullScale(NamedTuple):
    """The smallest and the largest possible reading, in the unit of readings."""

    low: float
    high: float

    def clipped(self, readings: Floats) -> Booleans:
        """Return which readings, of any shape, reach 0.999 of full scale, measured from the middle of the range."""
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        return np.asarray(np.abs(readings - middle) >= CLIPPED * half)


def volts_per_count(span_v: float, bits: int) -> float:
    """Return the size of one count of a converter, in volts.

    Parameters
    ----------
    span_v : float
        Range from the smallest to the largest input, in volts: 10 for +-5 V.
    bits : int
        Resolution of the converter.

    Raises
    ------
    SensorError
        If the span is not positive, or `bits` is not a whole number from 1 to 64.
    """
    if isinstance(bits, bool) or bits not in range(1, _MOST_BITS + 1):
        raise SensorError(f"bits = {bits!r} is not the resolution of a converter; give a whole number: 16 or 24.")
    return positive("span_v", span_v, "10.0") / 2.0 ** int(bits)
