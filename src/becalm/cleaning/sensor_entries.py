"""What a person writes about a sensor, one settings type for each kind, and the record that it makes."""

from __future__ import annotations

from datetime import date
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from becalm.cleaning.recipe_parts import Finite, NotNegative, Positive, Settings
from becalm.sensors.accelerometer import Accelerometer, FullScale, sensitivity_matrix, volts_per_count
from becalm.sensors.bridge import Bridge, Configuration
from becalm.sensors.curve import Curve
from becalm.sensors.load_cell import LoadCell
from becalm.sensors.record import Sensitivity, SensorRecord, Sheet

Three = tuple[Finite, Finite, Finite]
Name = Annotated[str, Field(min_length=1)]


class SheetEntry(Settings):
    """`becalm.sensors.record.Sheet`, as it is written; each line may be left out."""

    manufacturer: str = ""
    model: str = ""
    version: str = ""
    serial: str = ""
    calibrated: date | None = None
    due: date | None = None
    laboratory: str = ""
    certificate: str = ""
    reference_frequency_hz: NotNegative | None = None
    reference_temperature_degc: Finite | None = None
    range_low: Finite | None = None
    range_high: Finite | None = None
    impedance_ohm: Positive | None = None
    temperature_coefficient_percent_per_k: Finite | None = None
    direction: str = ""
    location: str = ""
    transverse_percent: NotNegative | None = None
    noise_density: Positive | None = None


class _Entry(Settings):
    """What every kind has.

    Attributes
    ----------
    raw_unit : {"V", "mV", "mV/V", "counts"}
        Of the readings that come.
    unit : str
        Of the result.
    span_v, bits : float, int or None
        Of the converter whose counts come: from its least to its greatest input, and its resolution.
    lowest_reading, highest_reading : float or None
        Full scale, in raw_unit; from 0.999 of it readings are clipped, and count as missing.
    zero_uncertainty : float
        Expanded (k = 2), of the result at rest, in unit; a *small* one trusts the zero.
    sheet : SheetEntry
        What else its sheet says.
    """

    raw_unit: Literal["V", "mV", "mV/V", "counts"]
    unit: Name
    span_v: Positive | None = None
    bits: Annotated[int, Field(ge=1, le=64)] | None = None
    lowest_reading: Finite | None = None
    highest_reading: Finite | None = None
    zero_uncertainty: NotNegative = 0.0
    sheet: SheetEntry = SheetEntry()

    @model_validator(mode="after")
    def _makes_a_record(self) -> Self:
        self.record()
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """The channels that the sensor feeds."""
        raise NotImplementedError

    def record(self) -> SensorRecord:
        """Make the record; every fault is a ValueError, and a sentence."""
        raise NotImplementedError

    def _shared(self) -> dict[str, Any]:
        """Return what is the same in the records of all kinds."""
        low, high = self.lowest_reading, self.highest_reading
        if (low is None) != (high is None) or (low is not None and high is not None and low >= high):
            raise ValueError("full scale goes from lowest_reading up to highest_reading; give both, or neither")
        if self.raw_unit != "counts" and (self.span_v is not None or self.bits is not None):
            raise ValueError('span_v and bits belong to raw_unit = "counts"; leave them out')
        return {
            "channels": self.names,
            "raw_unit": self.raw_unit,
            "unit": self.unit,
            "zero_uncertainty": self.zero_uncertainty,
            "full_scale": None if low is None or high is None else FullScale(low, high),
            "sheet": Sheet(**self.sheet.model_dump()),
        }

    def _volts(self) -> float:
        """Return the volts of one reading."""
        if self.raw_unit == "counts":
            if self.span_v is None or self.bits is None:
                raise ValueError('raw_unit = "counts" needs the converter\'s span_v and bits, as 10.0 and 16')
            return volts_per_count(self.span_v, self.bits)
        if self.raw_unit == "mV/V":
            raise ValueError('raw_unit = "mV/V" belongs to bridges and load cells; give volts or counts')
        return {"V": 1.0, "mV": 1e-3}[self.raw_unit]

    def _ratio(self, excitation_v: float | None) -> float:
        """Return the V/V of one reading."""
        if self.raw_unit == "mV/V":
            return 1e-3
        if excitation_v is None:
            raise ValueError(f'raw_unit = "{self.raw_unit}" needs excitation_v, as 5.0; readings in mV/V do not')
        return self._volts() / excitation_v


class _OneChannel(_Entry):
    channel: Name

    @property
    def names(self) -> tuple[str, ...]:
        """The one channel."""
        return (self.channel,)


class AccelerometerEntry(_OneChannel):
    """An accelerometer, or any sensor with one sensitivity.

    Attributes
    ----------
    sensitivity_mv, sensitivity_uncertainty_mv : float
        In mV per unit, and expanded (k = 2).
    bias_mv : float
        What it puts out at 0.
    """

    kind: Literal["accelerometer"]
    sensitivity_mv: Finite
    sensitivity_uncertainty_mv: NotNegative = 0.0
    bias_mv: Finite = 0.0

    def record(self) -> SensorRecord:
        """Make the record."""
        told = Sensitivity(self.sensitivity_mv, f"mV/{self.unit}", self.sensitivity_uncertainty_mv)
        one = Accelerometer(sensitivity_matrix([self.sensitivity_mv / 1e3]), np.array([self.bias_mv / 1e3]))
        return SensorRecord(**self._shared(), conversion=one, reading_size=self._volts(), sensitivities=(told,))


class TriaxialEntry(_Entry):
    """A triaxial accelerometer: by its sheet, or as its rests in many poses calibrated it.

    Attributes
    ----------
    channels : tuple of three str
        Its axes.
    sensitivity_mv, sensitivity_uncertainty_mv, bias_mv : tuple of three float
        As of an accelerometer, each axis along itself.
    cross_axis_percent : three tuples of three float, or None
        What each axis (a tuple) hears of each direction, in percent of its own sensitivity.
    correction : three tuples of three float, or None
        In place of sensitivities: a = correction (readings - bias), in unit per reading.
    bias : tuple of three float
        In readings, beside `correction`.
    """

    kind: Literal["triaxial"]
    channels: tuple[Name, Name, Name]
    sensitivity_mv: Three | None = None
    sensitivity_uncertainty_mv: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    cross_axis_percent: tuple[Three, Three, Three] | None = None
    bias_mv: Three = (0.0, 0.0, 0.0)
    correction: tuple[Three, Three, Three] | None = None
    bias: Three = (0.0, 0.0, 0.0)

    @property
    def names(self) -> tuple[str, ...]:
        """Its three channels."""
        return self.channels

    def record(self) -> SensorRecord:
        """Make the record."""
        by_sheet = {"sensitivity_uncertainty_mv", "cross_axis_percent", "bias_mv"} & self.model_fields_set
        if self.correction is not None and self.sensitivity_mv is None and not by_sheet:
            found = Accelerometer.corrected_by(self.correction, self.bias)
            return SensorRecord(**self._shared(), conversion=found)
        if self.sensitivity_mv is None or self.correction is not None or "bias" in self.model_fields_set:
            raise ValueError("give either sensitivity_mv, with bias_mv, or correction, with bias in readings")
        heard = sensitivity_matrix(np.array(self.sensitivity_mv) / 1e3, self.cross_axis_percent)
        told = tuple(
            Sensitivity(value, f"mV/{self.unit}", u)
            for value, u in zip(self.sensitivity_mv, self.sensitivity_uncertainty_mv, strict=True)
        )
        three = Accelerometer(heard, np.array(self.bias_mv) / 1e3)
        return SensorRecord(**self._shared(), conversion=three, reading_size=self._volts(), sensitivities=told)


class BridgeEntry(_OneChannel):
    """Strain gauges in a bridge, see `becalm.sensors.bridge.Bridge`.

    Attributes
    ----------
    gauge_factor, gauge_factor_uncertainty : float
        And expanded (k = 2).
    initial_mv_per_v : float
        What the unstrained bridge puts out.
    """

    kind: Literal["bridge"]
    unit: Literal["um/m", "m/m"] = "um/m"
    configuration: Configuration
    gauge_factor: Positive
    gauge_factor_uncertainty: NotNegative = 0.0
    poisson_ratio: NotNegative | None = None
    excitation_v: Positive | None = None
    gauge_ohm: Positive = 350.0
    lead_ohm: NotNegative = 0.0
    gain_adjustment: Positive = 1.0
    initial_mv_per_v: Finite = 0.0
    tension_lowers: bool = True

    def record(self) -> SensorRecord:
        """Make the record."""
        told = Sensitivity(self.gauge_factor, "(ohm/ohm)/(m/m)", self.gauge_factor_uncertainty)
        bridge = Bridge(
            self.configuration,
            self.gauge_factor,
            self.poisson_ratio,
            self.excitation_v,
            gauge_ohm=self.gauge_ohm,
            lead_ohm=self.lead_ohm,
            gain_adjustment=self.gain_adjustment,
            initial_ratio=1e-3 * self.initial_mv_per_v,
            tension_lowers=self.tension_lowers,
        )
        return SensorRecord(
            **self._shared(),
            conversion=bridge,
            reading_size=self._ratio(self.excitation_v),
            result_size=1e6 if self.unit == "um/m" else 1.0,
            sensitivities=(told,),
        )


class LoadCellEntry(_OneChannel):
    """A load cell, see `becalm.sensors.load_cell.LoadCell`.

    Attributes
    ----------
    rated_output_uncertainty_mv_per_v : float
        Expanded (k = 2).
    capacity : float
        In unit.
    """

    kind: Literal["load cell"]
    rated_output_mv_per_v: Finite
    rated_output_uncertainty_mv_per_v: NotNegative = 0.0
    capacity: Positive
    zero_balance_mv_per_v: Finite = 0.0
    excitation_v: Positive | None = None

    def record(self) -> SensorRecord:
        """Make the record."""
        cell = LoadCell(self.rated_output_mv_per_v, self.capacity, self.zero_balance_mv_per_v, self.excitation_v)
        told = Sensitivity(self.rated_output_mv_per_v, "mV/V", self.rated_output_uncertainty_mv_per_v)
        size = 1e3 * self._ratio(self.excitation_v)
        return SensorRecord(**self._shared(), conversion=cell, reading_size=size, sensitivities=(told,))


class CurveEntry(_OneChannel):
    """A calibration curve.

    Attributes
    ----------
    coefficients : tuple of float
        Of readings in raw_unit to the power of 0, 1, 2, ...
    """

    kind: Literal["polynomial"]
    coefficients: tuple[Finite, ...]

    def record(self) -> SensorRecord:
        """Make the record."""
        return SensorRecord(**self._shared(), conversion=Curve(self.coefficients))


SensorEntry = Annotated[
    AccelerometerEntry | TriaxialEntry | BridgeEntry | LoadCellEntry | CurveEntry, Field(discriminator="kind")
]
