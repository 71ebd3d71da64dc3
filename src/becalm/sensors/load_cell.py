"""Convert the output of a load cell to load, from rated output, capacity and zero balance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.checks import STANDARD_GRAVITY, finite, positive


@dataclass(frozen=True)
class LoadCell:
    """A load cell, described by its data sheet.

    Attributes
    ----------
    rated_output_mv_per_v : float
        Output at the capacity minus the output without load, in mV per volt of supply; negative if the signal wires are
        swapped.
    capacity : float
        Rated load, in the unit of the result: N, kg, N*m.
    zero_balance_mv_per_v : float
        Output without load, in mV per volt of supply.
    excitation_v : float or None
        Supply voltage in volts, if readings are voltages; None if they are ratios.

    Raises
    ------
    SensorError
        If a number is impossible.
    """

    rated_output_mv_per_v: float
    capacity: float
    zero_balance_mv_per_v: float = 0.0
    excitation_v: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        if finite("rated_output_mv_per_v", self.rated_output_mv_per_v, "2.0") == 0:
            raise SensorError("rated_output_mv_per_v = 0 gives no load; give the figure of the data sheet, e.g. 2.0.")
        positive("capacity", self.capacity, "500.0")
        finite("zero_balance_mv_per_v", self.zero_balance_mv_per_v, "0.02")
        if self.excitation_v is not None:
            positive("excitation_v", self.excitation_v, "10.0")

    def zeroed_at(self, ratio_mv_per_v: float) -> LoadCell:
        """Return a copy with this output without load, in mV/V."""
        return replace(self, zero_balance_mv_per_v=ratio_mv_per_v)

    def ratio(self, voltage_v: Floats) -> Floats:
        """Return the output (n,) in mV/V for voltages (n,) in volts.

        Raises
        ------
        SensorError
            If the excitation is not known.
        """
        if self.excitation_v is None:
            raise SensorError(
                "The excitation of the load cell is unknown; give excitation_v, e.g. 10.0, or readings in mV/V."
            )
        return np.asarray(1e3 * voltage_v / self.excitation_v)

    def load(self, ratio_mv_per_v: Floats) -> Floats:
        """Return the load (n,), in the unit of the capacity, of outputs (n,) in mV/V."""
        share = (ratio_mv_per_v - self.zero_balance_mv_per_v) / self.rated_output_mv_per_v
        return np.asarray(share * self.capacity)


def weight_n(mass_kg: Floats, gravity: float = STANDARD_GRAVITY) -> Floats:
    """Return the weight (n,), in N, of masses (n,) in kg, for a gravity in m/s^2.

    Raises
    ------
    SensorError
        If gravity is not positive.
    """
    return np.asarray(mass_kg * positive("gravity", gravity, "9.80665"))
