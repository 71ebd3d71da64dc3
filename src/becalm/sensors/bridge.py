"""Strain from a Wheatstone bridge, exactly: its ratio of voltages, and what leads and a shunt do to it.

Every circuit here turns a ratio r = V / V_excitation, less that of the unstrained bridge, into

    strain = - c r / (G (d0 + d1 r))

with c, d0, d1 of its own; G is the gauge factor. Signs are those of NI-DAQmx: tension lowers the ratio.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.checks import finite, positive

Configuration = Literal["quarter I", "quarter II", "half I", "half II", "full I", "full II", "full III"]

CONFIGURATIONS: tuple[Configuration, ...] = get_args(Configuration)

_WITH_POISSON = ("half I", "full II", "full III")


class _Terms(NamedTuple):
    """What makes one circuit's equation, see above."""

    c: float
    d0: float
    d1: float


class Shunt(NamedTuple):
    """A resistor that was put across a gauge in tension, as a check.

    Attributes
    ----------
    shunt_ohm : float
        Its resistance.
    ratio : float
        What the bridge put out meanwhile, in V/V, with no other load than when its zero was taken.
    """

    shunt_ohm: float
    ratio: float


@dataclass(frozen=True)
class Bridge:
    """A strain gauge bridge.

    Attributes
    ----------
    configuration : str
        "quarter I": one gauge; "quarter II": beside a dummy that sees the temperature only. "half I": one along and one
        across; "half II": bending, one in tension, one in compression. "full I": bending, all four along; "full II":
        bending, two across; "full III": axial, two along and two across.
    gauge_factor : float
        Relative change of resistance over strain.
    poisson_ratio : float or None
        Of the material, where gauges lie across: "half I", "full II", "full III".
    excitation_v : float or None
        Supply in volts, where readings are voltages; None where they are ratios.
    gauge_ohm, lead_ohm : float
        Resistance of a gauge, and of one lead in series with it, of quarter (three wires) and half bridges.
    gain_adjustment : float
        What strain is multiplied by, see the function of this name.
    shunt : Shunt or None
        What tells the gain adjustment in its place; it depends on the zero, and so is worked out when needed.
    initial_ratio : float
        Ratio of the unstrained bridge in V/V, see `becalm.sensors.tare`.
    tension_lowers : bool
        Whether tension lowers the ratio, as NI wires it; False where the signal's wires are swapped.

    Raises
    ------
    SensorError
        If a number is impossible, or the Poisson ratio is missing where it is needed.

    Notes
    -----
    Equations of NI-DAQmx, of a bridge that was balanced when unstrained; exact, not for small strain only.
    """

    configuration: Configuration
    gauge_factor: float
    poisson_ratio: float | None = None
    excitation_v: float | None = None
    gauge_ohm: float = 350.0
    lead_ohm: float = 0.0
    gain_adjustment: float = 1.0
    initial_ratio: float = 0.0
    tension_lowers: bool = True
    shunt: Shunt | None = None

    def __post_init__(self) -> None:
        """Check what came."""
        if self.configuration not in CONFIGURATIONS:
            raise SensorError(f"configuration = {self.configuration!r} is no bridge; use {', '.join(CONFIGURATIONS)}.")
        positive("gauge_factor", self.gauge_factor, "2.1")
        positive("gauge_ohm", self.gauge_ohm, "350.0")
        positive("lead_ohm", self.lead_ohm, "0.5", zero=True)
        positive("gain_adjustment", self.gain_adjustment, "1.0")
        finite("initial_ratio", self.initial_ratio, "2e-5")
        if self.shunt is not None:
            positive("shunt_ohm", self.shunt.shunt_ohm, "174650.0")
            finite("shunt_reading", self.shunt.ratio, "0.5")
        if self.excitation_v is not None:
            positive("excitation_v", self.excitation_v, "5.0")
        if self.poisson_ratio is not None:
            positive("poisson_ratio", self.poisson_ratio, "0.3", zero=True)
        elif self.configuration in _WITH_POISSON:
            raise SensorError(f"The bridge {self.configuration!r} has gauges across; give poisson_ratio, as 0.3.")

    def zeroed_at(self, ratio: float) -> Bridge:
        """Return the same bridge that put out this ratio, in V/V, when it was unstrained."""
        return replace(self, initial_ratio=ratio)

    @property
    def gain(self) -> float:
        """What strain is multiplied by: `gain_adjustment`, or what the shunt tells.

        Raises
        ------
        SensorError
            If no gain explains what was read of the shunt.

        Notes
        -----
        A shunt takes what cables and amplifier lose; it is no calibration of the gauge, its glue or its place.
        """
        if self.shunt is None:
            return self.gain_adjustment
        bare, sign = replace(self, shunt=None, gain_adjustment=1.0), self._sign()
        changed = self.gauge_factor * shunt_strain(self.gauge_ohm, self.shunt.shunt_ohm, self.gauge_factor)
        balanced = replace(bare, lead_ohm=0.0, initial_ratio=0.0)
        simulated = balanced.strain(np.array([-sign * changed / (4 + 2 * changed)]))  # of one gauge, changed so
        return gain_adjustment(float(simulated[0]), float(bare.strain(np.array([self.shunt.ratio]))[0]))

    def ratio(self, voltage_v: Floats) -> Floats:
        """Return the ratio (n,), in V/V, of the bridge's output (n,) in volts.

        Raises
        ------
        SensorError
            If the excitation is not known.
        """
        if self.excitation_v is None:
            raise SensorError("The bridge's excitation is not known; give excitation_v, as 5.0, or readings in mV/V.")
        return np.asarray(voltage_v / self.excitation_v)

    def strain(self, ratio: Floats) -> Floats:
        """Return the strain (n,), in m/m, of ratios (n,) in V/V; NaN where no gauge can give such a ratio."""
        r, terms = self._unbalance(ratio), self._terms()
        return np.asarray(-self._factor() * terms.c * r / _possible(terms.d0 + terms.d1 * r))

    def slope(self, ratio: Floats) -> Floats:
        """Return d strain / d ratio (n,), in m/m per V/V: the standard uncertainty of a ratio, times its magnitude."""
        terms = self._terms()
        bottom = _possible(terms.d0 + terms.d1 * self._unbalance(ratio))
        return np.asarray(-self._sign() * self._factor() * terms.c * terms.d0 / bottom**2)

    def _sign(self) -> float:
        return 1.0 if self.tension_lowers else -1.0

    def _unbalance(self, ratio: Floats) -> Floats:
        return np.asarray(self._sign() * (ratio - self.initial_ratio))

    def _factor(self) -> float:
        """Return what the ratio is multiplied by beside the circuit's own terms."""
        leads = 1.0 if self.configuration.startswith("full") else 1 + self.lead_ohm / self.gauge_ohm
        return self.gain * leads / self.gauge_factor

    def _terms(self) -> _Terms:
        nu = self.poisson_ratio or 0.0
        table: dict[Configuration, _Terms] = {
            "quarter I": _Terms(4, 1, 2),
            "quarter II": _Terms(4, 1, 2),
            "half I": _Terms(4, 1 + nu, 2 * (1 - nu)),
            "half II": _Terms(2, 1, 0),
            "full I": _Terms(1, 1, 0),
            "full II": _Terms(2, 1 + nu, 0),
            "full III": _Terms(2, 1 + nu, 1 - nu),
        }
        return table[self.configuration]


def _possible(bottom: Floats) -> Floats:
    """Return what is divided by, NaN where it is not positive: there a resistance would be infinite, or negative."""
    return np.where(bottom > 0, bottom, np.nan)


def shunt_strain(gauge_ohm: float, shunt_ohm: float, gauge_factor: float) -> float:
    """Return the strain, in m/m, that a resistor across a gauge simulates: compression, hence negative.

    Raises
    ------
    SensorError
        If a number is not positive.
    """
    gauge, shunt = positive("gauge_ohm", gauge_ohm, "350.0"), positive("shunt_ohm", shunt_ohm, "174650.0")
    return -gauge / (positive("gauge_factor", gauge_factor, "2.1") * (gauge + shunt))


def gain_adjustment(simulated: float, read: float) -> float:
    """Return what strain is multiplied by, so that a shunt reads what it simulates.

    Parameters
    ----------
    simulated : float
        By `shunt_strain`, in m/m.
    read : float
        What a bridge without adjustment read of it, less what it read before, in m/m.

    Raises
    ------
    SensorError
        If the two differ in sign, or by more than a factor of two: then something else is wrong.

    Notes
    -----
    This takes what cables and amplifier lose; it does not calibrate the gauge, its glue or its place.
    """
    wanted, came = finite("simulated", simulated, "-952e-6"), finite("read", read, "-940e-6")
    if not (came * wanted > 0 and 0.5 <= wanted / came <= 2):
        raise SensorError(
            f"The shunt simulates {1e6 * wanted:.6g} um/m and {1e6 * came:.6g} um/m were read, which no gain explains; "
            "look at the wiring, the shunt's resistance and the bridge's configuration."
        )
    return wanted / came
