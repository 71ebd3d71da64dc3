"""Load from a load cell: its rated output at its capacity, and its zero balance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.checks import STANDARD_GRAVITY, finite, positive


@dataclass(frozen=True)
class LoadCell:
    """A load cell, by its sheet.

    Attributes
    ----------
    rated_output_mv_per_v : float
        What it puts out at its capacity, beside its zero, per volt of supply; negative where the signal's wires
        are swapped.
    capacity : float
        In the unit of the result: N, kg, N*m.
    zero_balance_mv_per_v : float
        What it puts out without load.
    excitation_v : float or None
        Supply in volts, where readings are voltages; None where they are ratios.

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
        """Check what came."""
        if finite("rated_output_mv_per_v", self.rated_output_mv_per_v, "2.0") == 0:
            raise SensorError("rated_output_mv_per_v = 0 tells no load; give the sheet's figure, as 2.0.")
        positive("capacity", self.capacity, "500.0")
        finite("zero_balance_mv_per_v", self.zero_balance_mv_per_v, "0.02")
        if self.excitation_v is not None:
            positive("excitation_v", self.excitation_v, "10.0")

    def zeroed_at(self, ratio_mv_per_v: float) -> LoadCell:
        """Return the same cell that put out so many mV/V without load."""
        return replace(self, zero_balance_mv_per_v=ratio_mv_per_v)

    def ratio(self, voltage_v: Floats) -> Floats:
        """Return the output (n,) in mV/V of voltages (n,).

        Raises
        ------
        SensorError
            If the excitation is not known.
        """
        if self.excitation_v is None:
            raise SensorError("The cell's excitation is not known; give excitation_v, as 10.0, or readings in mV/V.")
        return np.asarray(1e3 * voltage_v / self.excitation_v)

    def load(self, ratio_mv_per_v: Floats) -> Floats:
        """Return the load (n,), in the unit of the capacity, of outputs (n,) in mV/V."""
        share = (ratio_mv_per_v - self.zero_balance_mv_per_v) / self.rated_output_mv_per_v
        return np.asarray(share * self.capacity)


def weight_n(mass_kg: Floats, gravity: float = STANDARD_GRAVITY) -> Floats:
    """Return the force (n,), in N, with which masses (n,) press on a cell where gravity is that many m/s^2.

    Raises
    ------
    SensorError
        If gravity is not positive.
    """
    return np.asarray(mass_kg * positive("gravity", gravity, "9.80665"))
