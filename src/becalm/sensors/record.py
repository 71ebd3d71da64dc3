"""Define records of sensors, with the data of their data sheets, and convert their readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import date
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.accelerometer import Accelerometer, FullScale
from becalm.sensors.bridge import Bridge
from becalm.sensors.curve import CalibrationCurve
from becalm.sensors.load_cell import LoadCell
from becalm.sensors.resonance import Resonance
from becalm.sensors.tare import Tare
from becalm.sensors.thermal import GaugeTemperature

COVERAGE = 2.0
"""Coverage factor k of the expanded uncertainties in data sheets."""


class Sensitivity(NamedTuple):
    """The sensitivity of one channel from its data sheet.

    Attributes
    ----------
    value : float
        Sensitivity, not 0.
    unit : str
        Unit of the sensitivity, such as mV/g.
    uncertainty : float
        Expanded uncertainty (k = 2), in the same unit.
    """

    value: float
    unit: str
    uncertainty: float = 0.0

    @property
    def relative_std(self) -> float:
        """Return the relative standard uncertainty (k = 1)."""
        return self.uncertainty / COVERAGE / abs(self.value)


@dataclass(frozen=True)
class Sheet:
    """The data of a paper or electronic (TEDS, IEEE 1451.4) data sheet that the conversion does not need.

    Attributes
    ----------
    manufacturer, model, version, serial, laboratory, certificate, direction, location : str
        Texts; "" if unknown.
    calibrated, due : date or None
        Date of the calibration, and date of the next one.
    reference_frequency_hz, reference_temperature_degc : float or None
        Conditions for which the sensitivity is given.
    range_low, range_high : float or None
        Measuring range, in unit of the result.
    impedance_ohm : float or None
        Impedance of the bridge or of the output.
    temperature_coefficient_percent_per_k : float or None
        Temperature coefficient of the sensitivity, in percent per kelvin.
    transverse_percent : float or None
        Largest sensitivity across the axis, in percent of that along it.
    noise_density : float or None
        One-sided noise density, in unit of the result per sqrt(Hz).
    resonance_hz, damping_ratio : float or None
        Resonance frequency and damping ratio of the proof mass; None as damping ratio counts as undamped.
    """

    manufacturer: str = ""
    model: str = ""
    version: str = ""
    serial: str = ""
    calibrated: date | None = None
    due: date | None = None
    laboratory: str = ""
    certificate: str = ""
    reference_frequency_hz: float | None = None
    reference_temperature_degc: float | None = None
    range_low: float | None = None
    range_high: float | None = None
    impedance_ohm: float | None = None
    temperature_coefficient_percent_per_k: float | None = None
    direction: str = ""
    location: str = ""
    transverse_percent: float | None = None
    noise_density: float | None = None
    resonance_hz: float | None = None
    damping_ratio: float | None = None

    @property
    def resonance(self) -> Resonance | None:
        """Return the resonance of the sensor; None if the data sheet does not give it."""
        return None if self.resonance_hz is None else Resonance(self.resonance_hz, self.damping_ratio or 0.0)

    def is_due(self, today: date) -> bool:
        """Return whether the next calibration is due; False without a due date."""
        return self.due is not None and today >= self.due


class Calibration(NamedTuple):
    """The calibration data that a converted channel keeps.

    Attributes
    ----------
    relative_std : float
        Relative standard uncertainty (k = 1) of the sensitivity.
    offset_std : float
        Standard uncertainty (k = 1) of the zero, in unit.
    tare : Tare or None
        The measured zero.
    resonance : Resonance or None
        Resonance of the sensor.
    """

    relative_std: float = 0.0
    offset_std: float = 0.0
    tare: Tare | None = None
    resonance: Resonance | None = None


@dataclass(frozen=True)
class SensorRecord:
    """One sensor: its channels, and the conversion of their readings.

    Attributes
    ----------
    channels : tuple of str
        Names of its channels: one, or three for a triaxial sensor.
    raw_unit, unit : str
        Units of the readings and of the result.
    conversion : Accelerometer, Bridge, LoadCell or CalibrationCurve
        Conversion of readings to the result.
    reading_size : float
        Factor from raw_unit to the input unit of the conversion: V, V/V (bridge) or mV/V (load cell).
    result_size : float
        Factor from the output unit of the conversion to unit: 1e6 from m/m to um/m.
    sensitivities : tuple of Sensitivity
        Sensitivity of each channel; empty for a calibration curve.
    zero_uncertainty : float
        Expanded uncertainty (k = 2) of the result without load, in unit.
    full_scale : FullScale or None
        The smallest and the largest possible reading, in raw_unit; with None no reading counts as clipped.
    tare_s : (float, float) or None
        Start and end of the stretch without load that gives the zero, in seconds after the first row; None keeps the
        zero of the data sheet.
    temperature : GaugeTemperature or None
        Effect of temperature on the gauges of a bridge; with None nothing is corrected.
    sheet : Sheet
        All other data.
    """

    channels: tuple[str, ...]
    raw_unit: str
    unit: str
    conversion: Accelerometer | Bridge | LoadCell | CalibrationCurve
    reading_size: float = 1.0
    result_size: float = 1.0
    sensitivities: tuple[Sensitivity, ...] = ()
    zero_uncertainty: float = 0.0
    full_scale: FullScale | None = None
    tare_s: tuple[float, float] | None = None
    temperature: GaugeTemperature | None = None
    sheet: Sheet = field(default_factory=Sheet)

    @property
    def needed(self) -> tuple[str, ...]:
        """Return the names of the channels of the sensor and of the temperature channel, if there is one."""
        channel = None if self.temperature is None else self.temperature.channel
        return self.channels if channel is None else (*self.channels, channel)

    @property
    def relative_stds(self) -> tuple[float, ...]:
        """Return the relative standard uncertainty (k = 1) of the sensitivity of each channel; 0 if unknown."""
        return tuple(one.relative_std for one in self.sensitivities) or (0.0,) * len(self.channels)

    @property
    def offset_std(self) -> float:
        """Return the standard uncertainty (k = 1) of the zero, in unit."""
        return self.zero_uncertainty / COVERAGE


def convert_readings(record: SensorRecord, columns: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return the measured quantities of a sensor from its readings.

    Parameters
    ----------
    record : SensorRecord
        The sensor.
    columns : mapping of str to (n,) float array
        Readings by channel, in raw_unit; a temperature channel in degC. Other columns are ignored.

    Returns
    -------
    dict of str to (n,) float array
        Channels of the sensor, in unit; NaN where a needed reading or the temperature is missing, or a reading is
        clipped.

    Raises
    ------
    SensorError
        If a channel is missing, or the columns differ in length.
    """
    for name in record.needed:
        if name not in columns:
            raise SensorError(f"The sensor's channel {name!r} is missing; there are {', '.join(columns) or 'none'}.")
    if len({np.shape(columns[name]) for name in record.needed}) > 1:
        raise SensorError(
            f"The columns {', '.join(record.needed)} differ in length; the columns of a sensor must be equally long."
        )
    readings = np.column_stack([np.asarray(columns[name], dtype=np.float64) for name in record.channels])
    if record.full_scale is not None:
        readings = np.where(record.full_scale.clipped(readings), np.nan, readings)
    with np.errstate(invalid="ignore", over="ignore"):  # infinite readings
        values = _converted(record.conversion, record.reading_size * readings)
    if record.temperature is not None and isinstance(record.conversion, Bridge):
        values = _correct_temperature(values, record.temperature, record.conversion.gauge_factor, columns)
    values = record.result_size * values
    return dict(zip(record.channels, values.T, strict=True))


def apply_tare(record: SensorRecord, tare: Tare) -> SensorRecord:
    """Return a sensor of one channel with a measured zero.

    Parameters
    ----------
    record : SensorRecord
        Sensor with `tare_s`; its `zero_uncertainty` covers causes that the measurement does not show, such as a later
        drift.
    tare : Tare
        The measured zero, in raw_unit of the sensor.

    Raises
    ------
    SensorError
        If all readings are equal, so that the uncertainty of the zero is unknown, or the zero does not fit the
        shunt of the sensor.
    """
    (name,) = record.channels
    value, std = tare.reading, tare.reading_std
    temperature = record.temperature
    if temperature is not None:
        temperature = replace(temperature, zero_degc=tare.temperature_degc)
    zeroed = replace(
        record,
        conversion=record.conversion.zeroed_at(record.reading_size * value),
        temperature=temperature,
        tare_s=None,
    )
    if std is None:
        if record.zero_uncertainty > 0:
            return zeroed
        raise SensorError(
            f"All {tare.readings} readings of the stretch are {value:.6g} {record.raw_unit}, so the uncertainty of"
            f" their mean is unknown; give zero_uncertainty, in {record.unit}."
        )
    columns = {name: np.array([value, value + std])}
    if temperature is not None and temperature.channel is not None:
        columns[temperature.channel] = np.full(2, tare.temperature_degc)
    at_zero, beyond = convert_readings(replace(zeroed, full_scale=None), columns)[name]
    expanded = COVERAGE * abs(float(beyond - at_zero))
    return replace(zeroed, zero_uncertainty=float(np.hypot(expanded, record.zero_uncertainty)))


def _correct_temperature(
    strain: Floats, temperature: GaugeTemperature, gauge_factor: float, columns: Mapping[str, Floats]
) -> Floats:
    """Return the strain (n, 1) of a bridge, corrected for temperature."""
    if temperature.constant_degc is not None:
        degc = np.full(len(strain), temperature.constant_degc)
    else:
        degc = np.asarray(columns[str(temperature.channel)], dtype=np.float64)
    return temperature.corrected(strain[:, 0], degc, gauge_factor)[:, np.newaxis]


def _converted(conversion: Accelerometer | Bridge | LoadCell | CalibrationCurve, readings: Floats) -> Floats:
    """Return the converted readings (n, m)."""
    match conversion:
        case Accelerometer():
            return conversion.acceleration(readings)
        case Bridge():
            return conversion.strain(readings)
        case LoadCell():
            return conversion.load(readings)
        case CalibrationCurve():
            return conversion.value(readings)
