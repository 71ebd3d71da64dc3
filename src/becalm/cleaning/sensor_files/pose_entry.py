"""Calibrate an accelerometer from a recording in many poses; report the result and make an entry for a sensor file."""

from __future__ import annotations

from datetime import date
from typing import Any, NamedTuple, get_args

import numpy as np

from becalm.cleaning.sensor_files.pose_calibration import find_poses
from becalm.cleaning.sensor_files.sensor_entries import TriaxialEntry
from becalm.cleaning.sensor_files.sensor_entry import RawUnit, SheetEntry
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.errors import SensorError
from becalm.sensors.checks import STANDARD_GRAVITY, positive
from becalm.sensors.poses import (
    FEWEST_POSES,
    PoseCalibration,
    Rests,
    calibrate_by_length,
    common_factor,
    nearest_sphere,
)
from becalm.sensors.record import COVERAGE

ACCELERATIONS = {"m/s^2": 1.0, "g": STANDARD_GRAVITY}
"""Units that an accelerometer can be calibrated in, with their size in m/s^2."""

LEAST_GRAVITY, MOST_GRAVITY = 9.780, 9.832
"""Gravity at sea level on the equator and at the poles, in m/s^2."""


class PoseReport(NamedTuple):
    """A calibration by poses, with its errors.

    Attributes
    ----------
    channels : tuple of three str
        Names of the axes.
    raw_unit, unit : str
        Units of the readings, and of the result.
    rests : int
        Number of rests that were found.
    calibration : PoseCalibration
        Calibration from these rests.
    before : float
        Standard deviation of |a| over the rests without this calibration, in unit. If the readings are accelerations,
        |a| is that of the readings; otherwise that with the best zero and one factor for all axes.
    after : float
        Standard deviation of |a| over the rests with this calibration, in unit.
    held_out : float
        Root mean square difference of |a| from gravity, in unit, if each rest is converted with a calibration from all
        other rests. NaN if there are only ten rests, or if the other rests are too similar for a calibration.
    gravity_relative_std : float
        Standard uncertainty (k = 1) of gravity, as a share.
    """

    channels: tuple[str, str, str]
    raw_unit: RawUnit
    unit: str
    rests: int
    calibration: PoseCalibration
    before: float
    after: float
    held_out: float
    gravity_relative_std: float

    @property
    def scales(self) -> Floats:
        """Return the scale of each axis along itself, (3,), in unit per reading."""
        return np.diag(self.calibration.matrix)

    @property
    def scale_uncertainties_percent(self) -> Floats:
        """Return the expanded (k = 2) uncertainty of each scale, (3,), in percent; that of gravity is included."""
        relative = np.diag(self.calibration.matrix_std) / np.abs(self.scales)
        return np.asarray(100 * COVERAGE * np.hypot(relative, self.gravity_relative_std))

    @property
    def zero_uncertainty(self) -> float:
        """Return the largest expanded (k = 2) uncertainty of the zero over the axes of the result, in unit."""
        of_axes = np.sqrt(self.calibration.matrix**2 @ self.calibration.bias_std**2)
        return float(COVERAGE * of_axes.max())

    def entry(self, calibrated: date) -> TriaxialEntry:
        """Return the entry for the sensor file; `calibrated` is the date of the calibration."""
        found: Any = self.calibration
        return TriaxialEntry(
            kind="triaxial",
            channels=self.channels,
            raw_unit=self.raw_unit,
            unit=self.unit,
            correction=found.matrix.tolist(),
            bias=found.bias.tolist(),
            scale_uncertainty_percent=self.scale_uncertainties_percent.tolist(),
            zero_uncertainty=self.zero_uncertainty,
            sheet=SheetEntry(calibrated=calibrated),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain values for JSON."""
        found = self.calibration
        return {
            "channels": list(self.channels),
            "raw_unit": self.raw_unit,
            "unit": self.unit,
            "rests": self.rests,
            "spread_before": self.before,
            "spread_after": self.after,
            "error_held_out": None if np.isnan(self.held_out) else self.held_out,
            "correction": found.matrix.tolist(),
            "correction_std": found.matrix_std.tolist(),
            "bias": found.bias.tolist(),
            "bias_std": found.bias_std.tolist(),
            "excess": found.excess,
            "scale_uncertainty_percent": self.scale_uncertainties_percent.tolist(),
            "zero_uncertainty": self.zero_uncertainty,
        }


def report_poses(recording: Recording, unit: str = "m/s^2", gravity: float | None = None) -> PoseReport:
    """Calibrate a triaxial accelerometer from a recording in which the sensor lay in many poses.

    Parameters
    ----------
    recording : Recording
        Three channels, all in V, mV, mV/V, counts, g or m/s^2; readings without a unit are taken as counts.
    unit : str
        Unit of the result: m/s^2 or g.
    gravity : float, optional
        Local gravity, in m/s^2, taken as exact. By default standard gravity, with an uncertainty for the variation of
        gravity over the Earth.

    Raises
    ------
    SensorError
        If there are not three channels, the rests are too few or too similar, or a unit or gravity is impossible.
    """
    if unit not in ACCELERATIONS:
        raise SensorError(f"--unit {unit} is not a unit for a calibration; write --unit m/s^2 or --unit g.")
    rests, raw_unit = find_poses(recording), _raw_unit(recording.units)
    gravity_m_s2 = STANDARD_GRAVITY if gravity is None else positive("--gravity", gravity, "9.81")
    gravity_std = (MOST_GRAVITY - LEAST_GRAVITY) / np.sqrt(12)  # standard deviation of a uniform distribution
    g = gravity_m_s2 / ACCELERATIONS[unit]
    found = calibrate_by_length(rests, g)
    return PoseReport(
        channels=(recording.names[0], recording.names[1], recording.names[2]),
        raw_unit=raw_unit,
        unit=unit,
        rests=len(rests.means),
        calibration=found,
        before=_before(rests.means, raw_unit, unit, g),
        after=found.spread(rests.means),
        held_out=_held_out(rests, g),
        gravity_relative_std=float(gravity_std / STANDARD_GRAVITY) if gravity is None else 0.0,
    )


def _raw_unit(units: tuple[str, ...]) -> RawUnit:
    """Return the unit of all three channels; raise a SensorError if they differ or a calibration cannot use it."""
    found = sorted(set(units))
    known: dict[str, RawUnit] = {unit: unit for unit in get_args(RawUnit)} | {"": "counts"}
    if len(found) != 1 or found[0] not in known:
        raise SensorError(
            f"The channels are in {', '.join(unit or 'no unit' for unit in found)}; all three must be in one of "
            f"{', '.join(get_args(RawUnit))}."
        )
    return known[found[0]]


def _before(means: Floats, raw_unit: str, unit: str, gravity: float) -> float:
    """Return the standard deviation of |a| over the rests without this calibration, in `unit`."""
    if raw_unit in ACCELERATIONS:
        magnitudes = np.linalg.norm(means, axis=1) * ACCELERATIONS[raw_unit] / ACCELERATIONS[unit]
        return float(magnitudes.std())
    return common_factor(means, nearest_sphere(means)[0], gravity).spread(means)


def _held_out(rests: Rests, gravity: float) -> float:
    """Return `PoseReport.held_out`, by leave-one-out cross-validation over the rests."""
    if len(rests.means) <= FEWEST_POSES:
        return np.nan
    errors = []
    for held_out in range(len(rests.means)):
        others = np.arange(len(rests.means)) != held_out
        try:
            found = calibrate_by_length(Rests(rests.means[others], rests.stds[others]), gravity)
        except SensorError:  # the other rests are too similar
            return np.nan
        errors.append(float(np.linalg.norm(found.acceleration(rests.means[[held_out]]))) - gravity)
    return float(np.sqrt(np.mean(np.square(errors))))
