"""From the filter's sigma to the standard uncertainty of the signal: its tuning's share, and its calibration's.

    u(x)^2 = ((1 + spread) sigma)^2 + (x relative_std)^2 + offset_std^2

The first term is random, and shrinks with averaging; the others are one error for all samples, and do not
(JCGM 100:2008, 3.3 and 5.1).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from becalm.cleaning.recipe_parts import CalibrationRecipe
from becalm.core.told import Told


class Uncertainty:
    """Widens sigma where the signal leaves, and keeps how large the signal was.

    Parameters
    ----------
    spread : float
        Share by which the tuning's spread widens sigma.
    calibration : CalibrationRecipe or None
        What is uncertain in the sensor's calibration.
    """

    def __init__(self, spread: float, calibration: CalibrationRecipe | None) -> None:
        self._factor, self._calibration = 1.0 + spread, calibration
        self._magnitudes, self._rows = 0.0, 0

    def widened(self, told: Sequence[Told]) -> list[Told]:
        """Return rows with their whole uncertainty."""
        if self._factor == 1.0 and self._calibration is None:
            return list(told)
        return [self._widened(rows) for rows in told]

    @property
    def calibration_std(self) -> float | None:
        """What the calibration adds, at the mean magnitude of the rows so far; None without one, or without rows."""
        if self._calibration is None or not self._rows:
            return None
        mean = self._magnitudes / self._rows
        return float(np.hypot(mean * self._calibration.relative_std, self._calibration.offset_std))

    def _widened(self, told: Told) -> Told:
        sigma = self._factor * told.sigma
        if self._calibration is not None:
            seen = np.abs(told.signal[np.isfinite(told.signal)])
            self._magnitudes, self._rows = self._magnitudes + float(seen.sum()), self._rows + len(seen)
            sensitivity = np.hypot(told.signal * self._calibration.relative_std, self._calibration.offset_std)
            sigma = np.where(np.isfinite(sensitivity), np.hypot(sigma, sensitivity), sigma)
        return told._replace(sigma=sigma)
