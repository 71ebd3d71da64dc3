"""A calibration curve: a polynomial from readings to what is measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.checks import finite


@dataclass(frozen=True)
class CalibrationCurve:
    """A polynomial.

    Attributes
    ----------
    coefficients : tuple of float
        Of readings to the power of 0, 1, 2, ..., in unit per reading to that power.

    Raises
    ------
    SensorError
        If there is none but the constant, or one is not finite.
    """

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check what came."""
        own = [finite("coefficients", value, "[0.0, 12.5]") for value in self.coefficients]
        if not any(own[1:]):
            raise SensorError("A curve with no coefficient beyond the first tells nothing; give them, as [0.0, 12.5].")

    def zeroed_at(self, reading: float) -> CalibrationCurve:
        """Return the same curve, moved so that this reading tells 0."""
        constant = self.coefficients[0] - float(self.value(np.array([reading]))[0])
        return CalibrationCurve((constant, *self.coefficients[1:]))

    def value(self, readings: Floats) -> Floats:
        """Return what is measured (n,) where readings (n,) came."""
        return np.asarray(np.polynomial.polynomial.polyval(readings, self.coefficients))
