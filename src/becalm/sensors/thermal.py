"""What temperature does to a strain gauge and its leads; no filter takes it off, since it is as slow as load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.checks import finite, finite_array, positive

SHEET_GAUGE_FACTOR = 2.0
"""The gauge factor at which sheets tell thermal output, whatever the gauge's own (Micro-Measurements TN-504)."""

COPPER_PER_K = 0.0039
"""Relative change of copper's resistance, per kelvin."""

REFERENCE_DEGC = 24.0
"""Where sheets tell the gauge factor, and where thermal output is 0."""

_MOST_COEFFICIENTS = 5


@dataclass(frozen=True)
class GaugeTemperature:
    """What temperature does to a gauge, by the sheet of its lot, and where its temperature is known from.

    Attributes
    ----------
    output_um : tuple of up to 5 floats
        Thermal output, see `thermal_output`; none where it is not told, or the bridge takes it off by itself.
    percent_per_100_k : float
        By which the gauge factor grows.
    reference_degc : float
        At which the sheet tells the gauge factor.
    constant_degc : float or None
        Temperature of the gauge, where it did not change.
    channel : str or None
        That tells it else, in degC.
    zero_degc : float or None
        At which the bridge's zero was taken, which holds the thermal output there; None takes thermal output off whole.

    Raises
    ------
    SensorError
        If a number is impossible, there are more than five, or not one of `constant_degc` and `channel` is given.
    """

    output_um: tuple[float, ...] = ()
    percent_per_100_k: float = 0.0
    reference_degc: float = REFERENCE_DEGC
    constant_degc: float | None = None
    channel: str | None = None
    zero_degc: float | None = None

    def __post_init__(self) -> None:
        """Check what came."""
        if (self.constant_degc is None) == (self.channel is None):
            raise SensorError(
                "What temperature does to a gauge needs its temperature: give either temperature_degc, as 35.0, or"
                " temperature_channel."
            )
        if self.constant_degc is not None:
            finite("temperature_degc", self.constant_degc, "35.0")
        if self.zero_degc is not None:
            finite("zero_degc", self.zero_degc, "24.0")
        self.corrected(np.zeros(1), np.zeros(1), SHEET_GAUGE_FACTOR)

    def corrected(self, strain: Floats, temperature_degc: Floats, gauge_factor: float) -> Floats:
        """Take temperature off strain.

        Parameters
        ----------
        strain : (n,) float array
            As read at `gauge_factor`, in m/m.
        temperature_degc : (n,) float array
            Of the gauge; NaN where it is not known, which makes the strain NaN.
        gauge_factor : float
            That of the sheet at `reference_degc`.

        Returns
        -------
        (n,) float array
            In m/m: what thermal output left, at the gauge factor of each temperature.
        """
        factor = gauge_factor_at(temperature_degc, gauge_factor, self.percent_per_100_k, self.reference_degc)
        factor = np.where(factor > 0, factor, np.nan)
        return np.asarray((strain - self._output(temperature_degc, gauge_factor)) * (gauge_factor / factor))

    def _output(self, temperature_degc: Floats, gauge_factor: float) -> Floats:
        """Return the thermal output (n,) that is still in the strain, in m/m."""
        if not self.output_um:
            return np.zeros(np.shape(temperature_degc))
        told = thermal_output(self.output_um, temperature_degc, gauge_factor)
        if self.zero_degc is None:
            return told
        return told - thermal_output(self.output_um, np.array([self.zero_degc]), gauge_factor)


def thermal_output(coefficients_um: Sequence[float], temperature_degc: Floats, gauge_factor: float) -> Floats:
    """Return the strain, in m/m, that a gauge reads of temperature alone; take it off what was read.

    Parameters
    ----------
    coefficients_um : sequence of up to 5 floats
        Of the sheet's polynomial, in um/m per degC to the power of 0, 1, 2, 3, 4; valid for one lot of gauges
        on one material.
    temperature_degc : (n,) float array
        Of the gauge.
    gauge_factor : float
        That the instrument was set to, at which strain was read.

    Raises
    ------
    SensorError
        If there is no coefficient or more than five, or a number is impossible.
    """
    if not 1 <= len(coefficients_um) <= _MOST_COEFFICIENTS:
        raise SensorError(f"{len(coefficients_um)} coefficients came; a sheet's thermal output has 1 to 5.")
    own = finite_array("coefficients_um", coefficients_um, (len(coefficients_um),))
    share = SHEET_GAUGE_FACTOR / positive("gauge_factor", gauge_factor, "2.1")
    return np.asarray(1e-6 * share * np.polynomial.polynomial.polyval(temperature_degc, own))


def gauge_factor_at(
    temperature_degc: Floats, gauge_factor: float, percent_per_100_k: float, reference_degc: float = REFERENCE_DEGC
) -> Floats:
    """Return the gauge factor (n,) at temperatures (n,), linear about the one at which the sheet tells it.

    Raises
    ------
    SensorError
        If a number is impossible.
    """
    slope = finite("percent_per_100_k", percent_per_100_k, "1.3") / 1e4
    warmer = temperature_degc - finite("reference_degc", reference_degc, "24.0")
    return np.asarray(positive("gauge_factor", gauge_factor, "2.1") * (1 + slope * warmer))


def two_wire_drift(lead_ohm: float, warmer_k: float, gauge_ohm: float, gauge_factor: float) -> float:
    """Return the strain, in m/m, that copper leads seem to show when they warm, where a gauge has two wires only.

    Parameters
    ----------
    lead_ohm : float
        Of both leads together.
    warmer_k : float
        By which they warm.
    gauge_ohm, gauge_factor : float
        Of the gauge.

    Raises
    ------
    SensorError
        If a number is impossible.
    """
    change = COPPER_PER_K * finite("warmer_k", warmer_k, "10.0") * positive("lead_ohm", lead_ohm, "1.0", zero=True)
    return change / (positive("gauge_ohm", gauge_ohm, "350.0") * positive("gauge_factor", gauge_factor, "2.1"))
