"""The entries of a sensor file, one class for each kind of sensor, and their conversion to sensor records."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from becalm.cleaning.recipes.recipe_parts import Finite, NotNegative, Positive
from becalm.cleaning.sensor_files.bridge_entry import BridgeEntry
from becalm.cleaning.sensor_files.sensor_entry import Name, OneChannel, SensorEntryBase
from becalm.sensors.accelerometer import Accelerometer, sensitivity_matrix
from becalm.sensors.curve import CalibrationCurve
from becalm.sensors.load_cell import LoadCell
from becalm.sensors.record import Sensitivity, SensorRecord

Three = tuple[Finite, Finite, Finite]


class AccelerometerEntry(OneChannel):
    """An accelerometer, or any sensor with one sensitivity.

    Attributes
    ----------
    sensitivity_mv, sensitivity_uncertainty_mv : float
        Sensitivity, in mV per unit, and its expanded (k = 2) uncertainty.
    bias_mv : float
        Output at 0, in mV.
    """

    kind: Literal["accelerometer"]
    zero_key: ClassVar[str] = "bias_mv"
    sensitivity_mv: Finite
    sensitivity_uncertainty_mv: NotNegative = 0.0
    bias_mv: Finite = 0.0

    def record(self) -> SensorRecord:
        """Return the sensor record."""
        sensitivity = Sensitivity(self.sensitivity_mv, f"mV/{self.unit}", self.sensitivity_uncertainty_mv)
        conversion = Accelerometer(sensitivity_matrix([self.sensitivity_mv / 1e3]), np.array([self.bias_mv / 1e3]))
        return SensorRecord(
            **self.shared_fields(),
            conversion=conversion,
            reading_size=self.volts_per_reading(),
            sensitivities=(sensitivity,),
        )


class TriaxialEntry(SensorEntryBase):
    """A triaxial accelerometer, calibrated by its data sheet or by readings at rest in many poses.

    Attributes
    ----------
    channels : tuple of three str
        Names of the channels of the three axes.
    sensitivity_mv, sensitivity_uncertainty_mv, bias_mv : tuple of three float
        As in `AccelerometerEntry`, for each axis along its own direction.
    cross_axis_percent : three tuples of three float, or None
        One tuple for each axis: its sensitivity to the three directions, in percent of that to its own direction.
    correction : three tuples of three float, or None
        Matrix that replaces the sensitivities: a = correction (readings - bias), in unit per raw_unit.
    bias : tuple of three float
        Zero of each axis, in raw_unit; only with `correction`.
    scale_uncertainty_percent : tuple of three float
        Expanded (k = 2) uncertainty of the scale of each axis, in percent; only with `correction`.
    """

    kind: Literal["triaxial"]
    channels: tuple[Name, Name, Name]
    sensitivity_mv: Three | None = None
    sensitivity_uncertainty_mv: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    cross_axis_percent: tuple[Three, Three, Three] | None = None
    bias_mv: Three = (0.0, 0.0, 0.0)
    correction: tuple[Three, Three, Three] | None = None
    bias: Three = (0.0, 0.0, 0.0)
    scale_uncertainty_percent: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the three channels."""
        return self.channels

    def record(self) -> SensorRecord:
        """Return the sensor record."""
        by_sheet = {"sensitivity_uncertainty_mv", "cross_axis_percent", "bias_mv"} & self.model_fields_set
        if self.correction is not None and self.sensitivity_mv is None and not by_sheet:
            return self._corrected(Accelerometer.corrected_by(self.correction, self.bias))
        by_poses = {"bias", "scale_uncertainty_percent"} & self.model_fields_set
        if self.sensitivity_mv is None or self.correction is not None or by_poses:
            raise ValueError("give either sensitivity_mv, with bias_mv, or correction, with bias in readings")
        matrix = sensitivity_matrix(np.array(self.sensitivity_mv) / 1e3, self.cross_axis_percent)
        by_axis = tuple(
            Sensitivity(value, f"mV/{self.unit}", u)
            for value, u in zip(self.sensitivity_mv, self.sensitivity_uncertainty_mv, strict=True)
        )
        conversion = Accelerometer(matrix, np.array(self.bias_mv) / 1e3)
        return SensorRecord(
            **self.shared_fields(),
            conversion=conversion,
            reading_size=self.volts_per_reading(),
            sensitivities=by_axis,
        )

    def _corrected(self, conversion: Accelerometer) -> SensorRecord:
        """Return the sensor record for a sensor with a `correction`."""
        sizes = np.linalg.norm(conversion.sensitivity, axis=1).tolist()  # of each axis, along its own direction
        by_axis = tuple(
            Sensitivity(size, f"{self.raw_unit}/{self.unit}", percent / 100 * size)
            for size, percent in zip(sizes, self.scale_uncertainty_percent, strict=True)
        )
        return SensorRecord(**self.shared_fields(), conversion=conversion, sensitivities=by_axis)


class LoadCellEntry(OneChannel):
    """A load cell, see `becalm.sensors.load_cell.LoadCell`.

    Attributes
    ----------
    rated_output_uncertainty_mv_per_v : float
        Expanded (k = 2) uncertainty of the rated output, in mV/V.
    capacity : float
        Rated load, in unit.
    """

    kind: Literal["load cell"]
    zero_key: ClassVar[str] = "zero_balance_mv_per_v"
    rated_output_mv_per_v: Finite
    rated_output_uncertainty_mv_per_v: NotNegative = 0.0
    capacity: Positive
    zero_balance_mv_per_v: Finite = 0.0
    excitation_v: Positive | None = None

    def record(self) -> SensorRecord:
        """Return the sensor record."""
        cell = LoadCell(self.rated_output_mv_per_v, self.capacity, self.zero_balance_mv_per_v, self.excitation_v)
        sensitivity = Sensitivity(self.rated_output_mv_per_v, "mV/V", self.rated_output_uncertainty_mv_per_v)
        size = 1e3 * self.bridge_ratio_per_reading(self.excitation_v)
        return SensorRecord(**self.shared_fields(), conversion=cell, reading_size=size, sensitivities=(sensitivity,))


class CurveEntry(OneChannel):
    """A sensor with a calibration curve.

    Attributes
    ----------
    coefficients : tuple of float
        Coefficients of a polynomial, constant first, that converts a reading in raw_unit to a result in unit.
    """

    kind: Literal["polynomial"]
    coefficients: tuple[Finite, ...]

    def record(self) -> SensorRecord:
        """Return the sensor record."""
        return SensorRecord(**self.shared_fields(), conversion=CalibrationCurve(self.coefficients))


SensorEntry = Annotated[
    AccelerometerEntry | TriaxialEntry | BridgeEntry | LoadCellEntry | CurveEntry, Field(discriminator="kind")
]
