"""The entry for a strain gauge bridge in a sensor file, and its conversion to a sensor record."""

from __future__ import annotations

from typing import ClassVar, Literal

from becalm.cleaning.recipes.recipe_parts import Finite, NotNegative, Positive
from becalm.cleaning.sensor_files.sensor_entry import Name, OneChannel
from becalm.sensors.bridge import Bridge, Configuration, Shunt
from becalm.sensors.record import Sensitivity, SensorRecord
from becalm.sensors.thermal import REFERENCE_DEGC, GaugeTemperature


class BridgeEntry(OneChannel):
    """A strain gauge bridge in a sensor file, see `becalm.sensors.bridge.Bridge`.

    Attributes
    ----------
    gauge_factor, gauge_factor_uncertainty : float
        Gauge factor and its expanded (k = 2) uncertainty.
    initial_mv_per_v : float
        Output of the unstrained bridge, in mV/V.
    shunt_ohm, shunt_reading : float or None
        Resistance of a shunt across a gauge in tension, and the reading with this shunt, in raw_unit, at the same load
        as for the zero. A shunt replaces `gain_adjustment`: it corrects the loss in cables and amplifier, but does not
        calibrate a gauge.
    thermal_output_um : tuple of up to 5 floats
        Coefficients of the thermal output for the powers 0 to 4 of the temperature in degC, in um/m, at a gauge factor
        of 2.0, from the data sheet of the gauge's lot; only for a quarter bridge without a dummy gauge.
    gauge_factor_percent_per_100_k, gauge_factor_reference_degc : float
        Increase of the gauge factor, in percent per 100 K, and the temperature, in degC, at which the data sheet gives
        the gauge factor.
    temperature_degc, temperature_channel : float, str or None
        Temperature of the gauge, in degC: a constant, or the name of a channel with the same time axis.
    """

    kind: Literal["bridge"]
    zero_key: ClassVar[str] = "initial_mv_per_v"
    unit: Literal["um/m", "m/m"] = "um/m"
    configuration: Configuration
    gauge_factor: Positive
    gauge_factor_uncertainty: NotNegative = 0.0
    poisson_ratio: NotNegative | None = None
    excitation_v: Positive | None = None
    gauge_ohm: Positive = 350.0
    lead_ohm: NotNegative = 0.0
    gain_adjustment: Positive = 1.0
    shunt_ohm: Positive | None = None
    shunt_reading: Finite | None = None
    initial_mv_per_v: Finite = 0.0
    tension_lowers: bool = True
    thermal_output_um: tuple[Finite, ...] = ()
    gauge_factor_percent_per_100_k: Finite = 0.0
    gauge_factor_reference_degc: Finite = REFERENCE_DEGC
    temperature_degc: Finite | None = None
    temperature_channel: Name | None = None

    def record(self) -> SensorRecord:
        """Return the sensor record."""
        sensitivity = Sensitivity(self.gauge_factor, "(ohm/ohm)/(m/m)", self.gauge_factor_uncertainty)
        size = self.bridge_ratio_per_reading(self.excitation_v)
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
            shunt=self._shunt(size),
        )
        shared = self.shared_fields()
        if self.tare is None:
            _ = bridge.gain  # without a tare the zero is known now: raise an error if no gain explains the shunt
        return SensorRecord(
            **shared,
            conversion=bridge,
            reading_size=size,
            result_size=1e6 if self.unit == "um/m" else 1.0,
            sensitivities=(sensitivity,),
            temperature=self._temperature(),
        )

    def _shunt(self, size: float) -> Shunt | None:
        if self.shunt_ohm is None and self.shunt_reading is None:
            return None
        if self.shunt_ohm is None or self.shunt_reading is None:
            raise ValueError("shunt_ohm and shunt_reading belong together; give both, or neither")
        if "gain_adjustment" in self.model_fields_set:
            raise ValueError("a shunt replaces gain_adjustment; give gain_adjustment alone, or leave it out")
        return Shunt(self.shunt_ohm, size * self.shunt_reading)

    def _temperature(self) -> GaugeTemperature | None:
        if not (self.thermal_output_um or self.gauge_factor_percent_per_100_k):
            if {"temperature_degc", "temperature_channel", "gauge_factor_reference_degc"} & self.model_fields_set:
                raise ValueError(
                    "a temperature changes nothing without thermal_output_um or gauge_factor_percent_per_100_k;"
                    " give one of them from the gauge's sheet, or leave it out"
                )
            return None
        if self.thermal_output_um and self.configuration != "quarter I":
            raise ValueError(
                f'in a bridge "{self.configuration}" gauges or a dummy compensate thermal output;'
                ' thermal_output_um is only for "quarter I", leave it out'
            )
        if self.temperature_channel == self.channel:
            raise ValueError("temperature_channel is the channel of the bridge itself; give the one of the thermometer")
        return GaugeTemperature(
            self.thermal_output_um,
            self.gauge_factor_percent_per_100_k,
            self.gauge_factor_reference_degc,
            self.temperature_degc,
            self.temperature_channel,
        )
