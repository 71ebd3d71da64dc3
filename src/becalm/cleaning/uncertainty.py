"""Compute the standard uncertainty of the signal from sigma, tuning, calibration and quantisation.

    u(x)^2 = ((1 + spread) sigma)^2 + (x relative_std)^2 + offset_std^2 + rounding_std^2

The first term is random and shrinks with averaging. The others are one error for all samples and do not shrink
(JCGM 100:2008, 3.3 and 5.1).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from becalm.cleaning.recipe_parts import CalibrationRecipe, LimitsRecipe
from becalm.core.arrays import Floats
from becalm.core.rows import EstimatedRows


class Uncertainty:
    """Widens sigma by tuning, calibration and quantisation, and sums up the magnitude of the signal.

    Parameters
    ----------
    spread : float
        Share by which sigma grows because the tuning is uncertain.
    calibration : CalibrationRecipe or None
        Uncertainty of the sensor's calibration.
    limits : LimitsRecipe or None
        Limits with the quantisation error that averaging does not remove.
    """

    def __init__(
        self, spread: float, calibration: CalibrationRecipe | None, limits: LimitsRecipe | None = None
    ) -> None:
        self._factor, self._calibration = 1.0 + spread, calibration
        self._systematic = lasting_std(calibration, limits)
        self._magnitudes, self._rows = 0.0, 0

    def widened(self, told: Sequence[EstimatedRows]) -> list[EstimatedRows]:
        """Return rows with their full uncertainty as sigma."""
        if self._factor == 1.0 and self._systematic is None:
            return list(told)
        return [self._widened(rows) for rows in told]

    @property
    def calibration_std(self) -> float | None:
        """Return the calibration's uncertainty at the mean magnitude so far, in unit; None if there is none."""
        if self._calibration is None or not self._rows:
            return None
        mean = self._magnitudes / self._rows
        return float(np.hypot(mean * self._calibration.relative_std, self._calibration.offset_std))

    def see(self, signal: Floats) -> None:
        """Add a signal (B,) to the mean magnitude."""
        if self._calibration is not None:
            seen = np.abs(signal[np.isfinite(signal)])
            self._magnitudes, self._rows = self._magnitudes + float(seen.sum()), self._rows + len(seen)

    def _widened(self, rows: EstimatedRows) -> EstimatedRows:
        sigma = self._factor * rows.sigma
        self.see(rows.signal)
        if self._systematic is not None:
            relative_std, offset_std = self._systematic
            sensitivity = np.hypot(rows.signal * relative_std, offset_std)
            sigma = np.where(np.isfinite(sensitivity), np.hypot(sigma, sensitivity), sigma)
        return rows._replace(sigma=sigma)


def lasting_std(calibration: CalibrationRecipe | None, limits: LimitsRecipe | None) -> tuple[float, float] | None:
    """Return the errors that averaging does not reduce: of the signal, as a share, and of the zero, in unit."""
    rounding_std = None if limits is None else limits.rounding_std
    if calibration is None:
        return None if rounding_std is None else (0.0, rounding_std)
    return calibration.relative_std, float(np.hypot(calibration.offset_std, rounding_std or 0.0))
