"""Correct strain for the temperature of a gauge and of its lead wires, a slow effect that filters cannot remove."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.checks import finite, finite_array, positive

SHEET_GAUGE_FACTOR = 2.0
"""Gauge factor for which data sheets give thermal output, independent of the gauge (Micro-Measurements TN-504)."""

COPPER_PER_K = 0.0039
"""Relative change of the resistance of copper, per kelvin."""

REFERENCE_DEGC = 24.0
"""Temperature for which data sheets give the gauge factor, and at which the thermal output is 0."""

_MOST_COEFFICIENTS = 5  # most coefficients of the polynomial of the thermal output


@dataclass(frozen=True)
class GaugeTemperature:
    """Effect of temperature on a gauge, from the data sheet of its lot, and the source of its temperature.

    Attributes
    ----------
    output_um : tuple of up to 5 floats
        Coefficients of the thermal output, see `thermal_output`; empty if they are unknown, or if the bridge
        compensates the thermal output.
    percent_per_100_k : float
        Increase of the gauge factor, in percent per 100 K.
    reference_degc : float
        Temperature for which the data sheet gives the gauge factor.
    constant_degc : float or None
        Temperature of the gauge, if it is constant.
    channel : str or None
        Name of the channel with the temperature of the gauge, in degC, if it is not constant.
    zero_degc : float or None
        Temperature at which the zero of the bridge was measured. That zero contains the thermal output at this
        temperature; with None the whole thermal output is subtracted.

    Raises
    ------
    SensorError
        If a number is impossible, there are more than five coefficients, or not exactly one of `constant_degc` and
        `channel` is given.
    """

    output_um: tuple[float, ...] = ()
    percent_per_100_k: float = 0.0
    reference_degc: float = REFERENCE_DEGC
    constant_degc: float | None = None
    channel: str | None = None
    zero_degc: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        if (self.constant_degc is None) == (self.channel is None):
            raise SensorError(
                "The temperature correction of a gauge needs its temperature: give either temperature_degc, e.g."
                " 35.0, or temperature_channel."
            )
        if self.constant_degc is not None:
            finite("temperature_degc", self.constant_degc, "35.0")
        if self.zero_degc is not None:
            finite("zero_degc", self.zero_degc, "24.0")
        self.corrected(np.zeros(1), np.zeros(1), SHEET_GAUGE_FACTOR)

    def corrected(self, strain: Floats, temperature_degc: Floats, gauge_factor: float) -> Floats:
        """Return strain without the effect of temperature.

        Parameters
        ----------
        strain : (n,) float array
            Strain as read with `gauge_factor`, in m/m.
        temperature_degc : (n,) float array
            Temperature of the gauge; the strain is NaN where this is NaN.
        gauge_factor : float
            Gauge factor of the data sheet at `reference_degc`.

        Returns
        -------
        (n,) float array
            Strain in m/m, less the thermal output, computed with the gauge factor at each temperature.
        """
        factor = gauge_factor_at(temperature_degc, gauge_factor, self.percent_per_100_k, self.reference_degc)
        factor = np.where(factor > 0, factor, np.nan)
        return np.asarray((strain - self._output(temperature_degc, gauge_factor)) * (gauge_factor / factor))

    def _output(self, temperature_degc: Floats, gauge_factor: float) -> Floats:
        """Return the thermal output (n,) that the strain still contains, in m/m."""
        if not self.output_um:
            return np.zeros(np.shape(temperature_degc))
        output = thermal_output(self.output_um, temperature_degc, gauge_factor)
        if self.zero_degc is None:
            return output
        return output - thermal_output(self.output_um, np.array([self.zero_degc]), gauge_factor)


def thermal_output(coefficients_um: Sequence[float], temperature_degc: Floats, gauge_factor: float) -> Floats:
    """Return the strain (n,), in m/m, that a gauge shows from temperature alone; subtract it from the readings.

    Parameters
    ----------
    coefficients_um : sequence of up to 5 floats
        Coefficients of the polynomial of the data sheet, in um/m per degC to the power of 0, 1, 2, 3, 4; valid for
        one lot of gauges on one material.
    temperature_degc : (n,) float array
        Temperature of the gauge, in degC.
    gauge_factor : float
        Gauge factor setting of the instrument that read the strain.

    Raises
    ------
    SensorError
        If there is no coefficient or more than five, or a number is impossible.
    """
    if not 1 <= len(coefficients_um) <= _MOST_COEFFICIENTS:
        raise SensorError(f"{len(coefficients_um)} coefficients came; the thermal output of a data sheet has 1 to 5.")
    own = finite_array("coefficients_um", coefficients_um, (len(coefficients_um),))
    share = SHEET_GAUGE_FACTOR / positive("gauge_factor", gauge_factor, "2.1")
    return np.asarray(1e-6 * share * np.polynomial.polynomial.polyval(temperature_degc, own))


def gauge_factor_at(
    temperature_degc: Floats, gauge_factor: float, percent_per_100_k: float, reference_degc: float = REFERENCE_DEGC
) -> Floats:
    """Return the gauge factor (n,) at temperatures (n,), in degC, linear from its value at the reference temperature.

    Raises
    ------
    SensorError
        If a number is impossible.
    """
    slope = finite("percent_per_100_k", percent_per_100_k, "1.3") / 1e4
    warmer = temperature_degc - finite("reference_degc", reference_degc, "24.0")
    return np.asarray(positive("gauge_factor", gauge_factor, "2.1") * (1 + slope * warmer))


def two_wire_drift(lead_ohm: float, warmer_k: float, gauge_ohm: float, gauge_factor: float) -> float:
    """Return the apparent strain, in m/m, that warming of its copper leads causes in a gauge with only two wires.

    Parameters
    ----------
    lead_ohm : float
        Resistance of both leads together.
    warmer_k : float
        Rise of the temperature of the leads, in kelvin.
    gauge_ohm, gauge_factor : float
        Resistance and gauge factor of the gauge.

    Raises
    ------
    SensorError
        If a number is impossible.
    """
    change = COPPER_PER_K * finite("warmer_k", warmer_k, "10.0") * positive("lead_ohm", lead_ohm, "1.0", zero=True)
    return change / (positive("gauge_ohm", gauge_ohm, "350.0") * positive("gauge_factor", gauge_factor, "2.1"))
