"""Define a calibration curve: a polynomial from readings to the measured quantity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.checks import finite


@dataclass(frozen=True)
class CalibrationCurve:
    """A polynomial from readings to the measured quantity.

    Attributes
    ----------
    coefficients : tuple of float
        Coefficients of the powers 0, 1, 2, ... of readings, in unit per reading to that power.

    Raises
    ------
    SensorError
        If all coefficients but the constant are 0, or a coefficient is not finite.
    """

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the coefficients."""
        own = [finite("coefficients", value, "[0.0, 12.5]") for value in self.coefficients]
        if not any(own[1:]):
            raise SensorError("All coefficients after the first are 0; give them, e.g. [0.0, 12.5].")

    def zeroed_at(self, reading: float) -> CalibrationCurve:
        """Return the curve with another constant, so that this reading gives 0."""
        constant = self.coefficients[0] - float(self.value(np.array([reading]))[0])
        return CalibrationCurve((constant, *self.coefficients[1:]))

    def value(self, readings: Floats) -> Floats:
        """Return the measured quantity (n,) for readings (n,)."""
        return np.asarray(np.polynomial.polynomial.polyval(readings, self.coefficients))
