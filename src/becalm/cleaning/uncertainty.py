"""From the filter's sigma to the standard uncertainty of the signal: its tuning's share, and its calibration's.

    u(x)^2 = ((1 + spread) sigma)^2 + (x relative_std)^2 + offset_std^2 + rounding_std^2

The first term is random, and shrinks with averaging; the others are one error for all samples, and do not
(JCGM 100:2008, 3.3 and 5.1).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from becalm.cleaning.recipe_parts import CalibrationRecipe, LimitsRecipe
from becalm.core.arrays import Floats
from becalm.core.rows import EstimatedRows


class Uncertainty:
    """Widens sigma where the signal leaves, and keeps how large the signal was.

    Parameters
    ----------
    spread : float
        Share by which the tuning's spread widens sigma.
    calibration : CalibrationRecipe or None
        What is uncertain in the sensor's calibration.
    limits : LimitsRecipe or None
        What its converter's steps leave.
    """

    def __init__(
        self, spread: float, calibration: CalibrationRecipe | None, limits: LimitsRecipe | None = None
    ) -> None:
        self._factor, self._calibration = 1.0 + spread, calibration
        self._lasting = lasting_std(calibration, limits)
        self._magnitudes, self._rows = 0.0, 0

    def widened(self, told: Sequence[EstimatedRows]) -> list[EstimatedRows]:
        """Return rows with their whole uncertainty."""
        if self._factor == 1.0 and self._lasting is None:
            return list(told)
        return [self._widened(rows) for rows in told]

    @property
    def calibration_std(self) -> float | None:
        """What the calibration adds, at the mean magnitude of the rows so far; None without one, or without rows."""
        if self._calibration is None or not self._rows:
            return None
        mean = self._magnitudes / self._rows
        return float(np.hypot(mean * self._calibration.relative_std, self._calibration.offset_std))

    def see(self, signal: Floats) -> None:
        """Take a signal (B,), to know how large it is on average."""
        if self._calibration is not None:
            seen = np.abs(signal[np.isfinite(signal)])
            self._magnitudes, self._rows = self._magnitudes + float(seen.sum()), self._rows + len(seen)

    def _widened(self, told: EstimatedRows) -> EstimatedRows:
        sigma = self._factor * told.sigma
        self.see(told.signal)
        if self._lasting is not None:
            relative_std, offset_std = self._lasting
            sensitivity = np.hypot(told.signal * relative_std, offset_std)
            sigma = np.where(np.isfinite(sensitivity), np.hypot(sigma, sensitivity), sigma)
        return told._replace(sigma=sigma)


def lasting_std(calibration: CalibrationRecipe | None, limits: LimitsRecipe | None) -> tuple[float, float] | None:
    """Return what averaging does not lower: of the signal, as a share, and of its zero, in unit; None for nothing."""
    rounding_std = None if limits is None else limits.rounding_std
    if calibration is None:
        return None if rounding_std is None else (0.0, rounding_std)
    return calibration.relative_std, float(np.hypot(calibration.offset_std, rounding_std or 0.0))
