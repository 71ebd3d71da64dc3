"""The settings that every kind of sensor has in a sensor file: units, converter, full scale and data sheet."""

from __future__ import annotations

from abc import ABC, abstractmethod
from datetime import date
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from becalm.cleaning.recipes.recipe_parts import Finite, FrozenSettings, NotNegative, Positive
from becalm.cleaning.stretches import stretch_s
from becalm.sensors.accelerometer import FullScale, volts_per_count
from becalm.sensors.record import SensorRecord, Sheet

Name = Annotated[str, Field(min_length=1)]
_VOLTS = {"V": 1.0, "mV": 1e-3}
RawUnit = Literal["V", "mV", "mV/V", "counts", "g", "m/s^2"]


class SheetEntry(FrozenSettings):
    """The data sheet of a sensor, see `becalm.sensors.record.Sheet`; each key is optional."""

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
    resonance_hz: Positive | None = None
    damping_ratio: NotNegative | None = None

    @model_validator(mode="after")
    def _damping_is_of_a_resonance(self) -> Self:
        if self.damping_ratio is not None and self.resonance_hz is None:
            raise ValueError("damping_ratio needs resonance_hz; give both, or leave it out")
        return self


class SensorEntryBase(FrozenSettings, ABC):
    """The entry of one sensor in a sensor file, with the settings that every kind of sensor has.

    Attributes
    ----------
    raw_unit : {"V", "mV", "mV/V", "counts", "g", "m/s^2"}
        Unit of the readings; "g" and "m/s^2" only for a triaxial accelerometer with a `correction`.
    unit : str
        Unit of the result.
    span_v, bits : float, int or None
        Range of the analogue-to-digital converter in volts, and its resolution in bits; for readings in counts.
    lowest_reading, highest_reading : float or None
        Full scale, in raw_unit; readings at or beyond 0.999 of full scale are clipped, and count as missing.
    zero_uncertainty : float
        Expanded (k = 2) uncertainty of the result without load, in unit; a *small* value trusts the zero.
    sheet : SheetEntry
        Data sheet of the sensor.
    """

    raw_unit: RawUnit
    unit: Name
    span_v: Positive | None = None
    bits: Annotated[int, Field(ge=1, le=64, strict=True)] | None = None
    lowest_reading: Finite | None = None
    highest_reading: Finite | None = None
    zero_uncertainty: NotNegative = 0.0
    sheet: SheetEntry = SheetEntry()

    @model_validator(mode="after")
    def _check_record(self) -> Self:
        self.record()
        return self

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Return the names of the sensor's channels."""

    @abstractmethod
    def record(self) -> SensorRecord:
        """Return the sensor record; raise a ValueError if the entry is not valid."""

    def shared_fields(self) -> dict[str, Any]:
        """Return the fields that sensor records of every kind have, by name; raise a ValueError if one is not valid."""
        low, high = self.lowest_reading, self.highest_reading
        if (low is None) != (high is None) or (low is not None and high is not None and low >= high):
            raise ValueError("lowest_reading must be less than highest_reading; give both, or neither")
        if self.raw_unit != "counts" and (self.span_v is not None or self.bits is not None):
            raise ValueError('span_v and bits are only for raw_unit = "counts"; leave them out')
        return {
            "channels": self.names,
            "raw_unit": self.raw_unit,
            "unit": self.unit,
            "zero_uncertainty": self.zero_uncertainty,
            "full_scale": None if low is None or high is None else FullScale(low, high),
            "sheet": Sheet(**self.sheet.model_dump()),
        }

    def volts_per_reading(self) -> float:
        """Return the voltage at a reading of 1, in V; raise a ValueError if raw_unit cannot be converted to volts."""
        if self.raw_unit == "counts":
            if self.span_v is None or self.bits is None:
                raise ValueError('raw_unit = "counts" needs the converter\'s span_v and bits, such as 10.0 and 16')
            return volts_per_count(self.span_v, self.bits)
        if self.raw_unit == "mV/V":
            raise ValueError('raw_unit = "mV/V" is only for bridges and load cells; give volts or counts')
        if self.raw_unit not in _VOLTS:
            raise ValueError(f'raw_unit = "{self.raw_unit}" is only for a triaxial sensor with correction; give volts')
        return _VOLTS[self.raw_unit]

    def bridge_ratio_per_reading(self, excitation_v: float | None) -> float:
        """Return the bridge output at a reading of 1, in V/V; raise a ValueError if raw_unit cannot be converted."""
        if self.raw_unit == "mV/V":
            return 1e-3
        if excitation_v is None:
            raise ValueError(f'raw_unit = "{self.raw_unit}" needs excitation_v, such as 5.0; readings in mV/V do not')
        return self.volts_per_reading() / excitation_v


class OneChannel(SensorEntryBase):
    """A sensor with one channel.

    Attributes
    ----------
    tare : str or None
        Stretch of the recording without load in which the zero is measured: "0s:20s" is the first 20 s. The readings
        must be quiet there. The zero of an accelerometer includes gravity.
    """

    channel: Name
    tare: str | None = None
    zero_key: ClassVar[str] = ""  # name of the setting that gives the zero if there is no tare

    @property
    def names(self) -> tuple[str, ...]:
        """Return the name of the one channel."""
        return (self.channel,)

    def shared_fields(self) -> dict[str, Any]:
        """Return the fields that sensor records of every kind have, and the stretch of the tare."""
        if self.tare is not None and self.zero_key in self.model_fields_set:
            raise ValueError(f"tare and {self.zero_key} both give the zero; give only one of them")
        return super().shared_fields() | {"tare_s": None if self.tare is None else _span_s(self.tare)}


def _span_s(text: str) -> tuple[float, float]:
    """Return the start and end of a stretch, in seconds; raise a ValueError if the text is not START:STOP."""
    span_s = stretch_s(text)
    if span_s is None:
        raise ValueError(
            f'tare = "{text}" is not a stretch of time; write START:STOP after the first row, such as "0s:20s"'
        )
    return span_s
