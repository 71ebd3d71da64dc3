"""A calibration record: what a sensor's sheet says, in plain values, and readings turned into what is measured."""

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
"""k of the expanded uncertainties that sheets tell."""


class Sensitivity(NamedTuple):
    """The sensitivity of one channel, as its sheet tells it.

    Attributes
    ----------
    value : float
        Not zero.
    unit : str
        As mV/g.
    uncertainty : float
        Expanded (k = 2), in this unit.
    """

    value: float
    unit: str
    uncertainty: float = 0.0

    @property
    def relative_std(self) -> float:
        """Its standard uncertainty (k = 1), as a share."""
        return self.uncertainty / COVERAGE / abs(self.value)


@dataclass(frozen=True)
class Sheet:
    """What a sheet, or an electronic one (TEDS, IEEE 1451.4), says beside the conversion.

    Attributes
    ----------
    manufacturer, model, version, serial, laboratory, certificate, direction, location : str
        "" where not told.
    calibrated, due : date or None
        When it was, and when it must be again.
    reference_frequency_hz, reference_temperature_degc : float or None
        At which the sensitivity holds.
    range_low, range_high : float or None
        In unit of the result.
    impedance_ohm : float or None
        Of the bridge, or the output.
    temperature_coefficient_percent_per_k : float or None
        Of the sensitivity.
    transverse_percent : float or None
        The greatest sensitivity across the axis, of that along it.
    noise_density : float or None
        In unit of the result per sqrt(Hz), one-sided.
    resonance_hz, damping_ratio : float or None
        Of its proof mass, or spring; without a damping it is taken to have none.
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
        """What its resonance does to what it measures; None where the sheet does not tell it."""
        return None if self.resonance_hz is None else Resonance(self.resonance_hz, self.damping_ratio or 0.0)

    def is_due(self, today: date) -> bool:
        """Tell whether the day has come on which it must be calibrated again; without such a day it never does."""
        return self.due is not None and today >= self.due


class Calibration(NamedTuple):
    """What must be known of a channel after its sensor turned it into its unit.

    Attributes
    ----------
    relative_std : float
        Standard uncertainty (k = 1) of the sensitivity, as a share.
    offset_std : float
        Standard uncertainty (k = 1) of the zero, in unit.
    tare : Tare or None
        The zero that was taken.
    resonance : Resonance or None
        Of the sensor.
    """

    relative_std: float = 0.0
    offset_std: float = 0.0
    tare: Tare | None = None
    resonance: Resonance | None = None


@dataclass(frozen=True)
class SensorRecord:
    """One sensor: which channels it feeds, and how their readings become what is measured.

    Attributes
    ----------
    channels : tuple of str
        One, or the three of a triaxial sensor.
    raw_unit, unit : str
        Of the readings that come, and of the result.
    conversion : Accelerometer, Bridge, LoadCell or Curve
        What turns one into the other.
    reading_size : float
        What the conversion takes, of one reading: its volts, its V/V (of a bridge), its mV/V (of a load cell).
    result_size : float
        What the result is, of one that the conversion gives: 1e6 for um/m of m/m.
    sensitivities : tuple of Sensitivity
        One a channel; empty where a curve tells all.
    zero_uncertainty : float
        Expanded (k = 2), of the result without load, in unit.
    full_scale : FullScale or None
        The least and the greatest reading, in raw_unit; None calls no reading clipped.
    tare_s : (float, float) or None
        The stretch without load from which the zero is to be taken, in seconds after the first row; None keeps the
        zero of the sheet.
    temperature : GaugeTemperature or None
        What temperature does to the gauges of a bridge; None corrects nothing.
    sheet : Sheet
        All else.
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
        """Its channels, and the one that tells the temperature, if one does."""
        told = None if self.temperature is None else self.temperature.channel
        return self.channels if told is None else (*self.channels, told)

    @property
    def relative_stds(self) -> tuple[float, ...]:
        """Standard uncertainty (k = 1) of each channel's sensitivity, as a share; 0 where none was told."""
        return tuple(one.relative_std for one in self.sensitivities) or (0.0,) * len(self.channels)

    @property
    def offset_std(self) -> float:
        """Standard uncertainty (k = 1) of the zero, in unit."""
        return self.zero_uncertainty / COVERAGE


def applied(record: SensorRecord, columns: Mapping[str, Floats]) -> dict[str, Floats]:
    """Turn readings into what is measured.

    Parameters
    ----------
    record : SensorRecord
        Of the sensor.
    columns : mapping of str to (n,) float array
        Readings by channel, in raw_unit; a channel of temperature in degC. Others are not looked at.

    Returns
    -------
    dict of str to (n,) float array
        The sensor's channels, in unit; NaN where a reading that is needed, or the temperature, is missing, or
        a reading is clipped.

    Raises
    ------
    SensorError
        If a channel is not there, or its columns differ in length.
    """
    for name in record.needed:
        if name not in columns:
            raise SensorError(f"The sensor's channel {name!r} is not there; there are {', '.join(columns) or 'none'}.")
    if len({np.shape(columns[name]) for name in record.needed}) > 1:
        raise SensorError(f"The columns {', '.join(record.needed)} differ in length; one sensor reads them together.")
    readings = np.column_stack([np.asarray(columns[name], dtype=np.float64) for name in record.channels])
    if record.full_scale is not None:
        readings = np.where(record.full_scale.clipped(readings), np.nan, readings)
    with np.errstate(invalid="ignore", over="ignore"):  # of a reading that is inf
        told = _converted(record.conversion, record.reading_size * readings)
    if record.temperature is not None and isinstance(record.conversion, Bridge):
        told = _without_temperature(told, record.temperature, record.conversion.gauge_factor, columns)
    told = record.result_size * told
    return dict(zip(record.channels, told.T, strict=True))


def tared(record: SensorRecord, tare: Tare) -> SensorRecord:
    """Return a sensor of one channel with the zero that was taken.

    Parameters
    ----------
    record : SensorRecord
        With `tare_s`; its `zero_uncertainty` is what is uncertain beside the taking, as a zero that wanders later.
    tare : Tare
        In its raw_unit.

    Raises
    ------
    SensorError
        If readings that did not vary leave unknown how uncertain the zero is, or the zero does not fit the
        sensor's shunt.
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
            f"All {tare.readings} readings of the stretch are {value:.6g} {record.raw_unit}, so that it is not known"
            f" how uncertain their mean is; give zero_uncertainty, in {record.unit}."
        )
    columns = {name: np.array([value, value + std])}
    if temperature is not None and temperature.channel is not None:
        columns[temperature.channel] = np.full(2, tare.temperature_degc)
    at_zero, beyond = applied(replace(zeroed, full_scale=None), columns)[name]
    told = COVERAGE * abs(float(beyond - at_zero))
    return replace(zeroed, zero_uncertainty=float(np.hypot(told, record.zero_uncertainty)))


def _without_temperature(
    strain: Floats, temperature: GaugeTemperature, gauge_factor: float, columns: Mapping[str, Floats]
) -> Floats:
    """Return the strain (n, 1) of a bridge without what temperature did to it."""
    if temperature.constant_degc is not None:
        degc = np.full(len(strain), temperature.constant_degc)
    else:
        degc = np.asarray(columns[str(temperature.channel)], dtype=np.float64)
    return temperature.corrected(strain[:, 0], degc, gauge_factor)[:, np.newaxis]


def _converted(conversion: Accelerometer | Bridge | LoadCell | CalibrationCurve, readings: Floats) -> Floats:
    """Return what a conversion makes of readings (n, m)."""
    match conversion:
        case Accelerometer():
            return conversion.acceleration(readings)
        case Bridge():
            return conversion.strain(readings)
        case LoadCell():
            return conversion.load(readings)
        case CalibrationCurve():
            return conversion.value(readings)
