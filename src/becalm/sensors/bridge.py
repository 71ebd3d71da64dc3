"""Convert the output of a Wheatstone bridge to strain, exactly, and correct for lead wires and a shunt.

For every circuit here, with r = V / V_excitation minus the ratio of the unstrained bridge,

    strain = - c r / (G (d0 + d1 r))

where c, d0, d1 depend on the circuit and G is the gauge factor. Signs are those of NI-DAQmx: tension lowers the ratio.
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

_WITH_POISSON = ("half I", "full II", "full III")  # configurations with gauges across the strain


class _Terms(NamedTuple):
    """Coefficients of the strain equation of one circuit; see the docstring of the module."""

    c: float
    d0: float
    d1: float


class Shunt(NamedTuple):
    """A shunt calibration: a resistor across a gauge in tension, and the reading with this resistor.

    Attributes
    ----------
    shunt_ohm : float
        Resistance of the shunt.
    ratio : float
        Output of the bridge with the shunt, in V/V, at the same load as for the zero.
    """

    shunt_ohm: float
    ratio: float


@dataclass(frozen=True)
class Bridge:
    """A strain gauge bridge.

    Attributes
    ----------
    configuration : str
        "quarter I": one gauge; "quarter II": one gauge and a dummy for the temperature. "half I": one gauge along, one
        across; "half II": bending, one gauge in tension, one in compression. "full I": bending, all four gauges along;
        "full II": bending, two across; "full III": axial, two along and two across.
    gauge_factor : float
        Relative change of resistance per strain.
    poisson_ratio : float or None
        Poisson ratio of the material, for bridges with gauges across: "half I", "full II", "full III".
    excitation_v : float or None
        Supply voltage in volts, if readings are voltages; None if they are ratios.
    gauge_ohm, lead_ohm : float
        Resistance of a gauge, and of one lead wire in series with it, for quarter (three wires) and half bridges.
    gain_adjustment : float
        Factor of the strain; see the function of this name.
    shunt : Shunt or None
        Shunt calibration that replaces `gain_adjustment`; the gain is computed when needed, because it depends on the
        zero.
    initial_ratio : float
        Ratio of the unstrained bridge, in V/V; see `becalm.sensors.tare`.
    tension_lowers : bool
        True if tension lowers the ratio, as in the wiring of NI; False if the signal wires are swapped.

    Raises
    ------
    SensorError
        If a number is impossible, or the Poisson ratio is missing where it is needed.

    Notes
    -----
    The equations are those of NI-DAQmx for a bridge that is balanced when unstrained; they are exact, also for large
    strain.
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
        """Check the values."""
        if self.configuration not in CONFIGURATIONS:
            raise SensorError(
                f"configuration = {self.configuration!r} is not a bridge; use {', '.join(CONFIGURATIONS)}."
            )
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
            raise SensorError(f"The bridge {self.configuration!r} has gauges across; give poisson_ratio, e.g. 0.3.")

    def zeroed_at(self, ratio: float) -> Bridge:
        """Return a copy whose unstrained bridge has this ratio, in V/V."""
        return replace(self, initial_ratio=ratio)

    @property
    def gain(self) -> float:
        """Return the factor of the strain: `gain_adjustment`, or the factor from the shunt calibration.

        Raises
        ------
        SensorError
            If no gain explains the reading of the shunt.

        Notes
        -----
        A shunt calibration corrects the losses in cables and amplifier, but not errors of the gauge, its glue or its
        place.
        """
        if self.shunt is None:
            return self.gain_adjustment
        unadjusted, sign = replace(self, shunt=None, gain_adjustment=1.0), self._sign()
        changed = self.gauge_factor * shunt_strain(self.gauge_ohm, self.shunt.shunt_ohm, self.gauge_factor)
        balanced = replace(unadjusted, lead_ohm=0.0, initial_ratio=0.0)
        # the shunt changes the resistance of one gauge by the share `changed`
        simulated = balanced.strain(np.array([-sign * changed / (4 + 2 * changed)]))
        return gain_adjustment(float(simulated[0]), float(unadjusted.strain(np.array([self.shunt.ratio]))[0]))

    def ratio(self, voltage_v: Floats) -> Floats:
        """Return the ratio (n,), in V/V, for an output (n,) in volts.

        Raises
        ------
        SensorError
            If the excitation is not known.
        """
        if self.excitation_v is None:
            raise SensorError(
                "The excitation of the bridge is unknown; give excitation_v, e.g. 5.0, or readings in mV/V."
            )
        return np.asarray(voltage_v / self.excitation_v)

    def strain(self, ratio: Floats) -> Floats:
        """Return the strain (n,), in m/m, of ratios (n,) in V/V; NaN where a ratio is impossible."""
        r, terms = self._unbalance(ratio), self._terms()
        return np.asarray(-self._factor() * terms.c * r / _valid_denominator(terms.d0 + terms.d1 * r))

    def slope(self, ratio: Floats) -> Floats:
        """Return d strain / d ratio (n,), in m/m per V/V; its magnitude converts standard uncertainties of a ratio."""
        terms = self._terms()
        denominator = _valid_denominator(terms.d0 + terms.d1 * self._unbalance(ratio))
        return np.asarray(-self._sign() * self._factor() * terms.c * terms.d0 / denominator**2)

    def _sign(self) -> float:
        return 1.0 if self.tension_lowers else -1.0

    def _unbalance(self, ratio: Floats) -> Floats:
        return np.asarray(self._sign() * (ratio - self.initial_ratio))

    def _factor(self) -> float:
        """Return the factor of the strain from gain, lead wires and gauge factor."""
        lead_factor = 1.0 if self.configuration.startswith("full") else 1 + self.lead_ohm / self.gauge_ohm
        return self.gain * lead_factor / self.gauge_factor

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


def _valid_denominator(denominator: Floats) -> Floats:
    """Return the denominator, NaN where it is not positive: a resistance would be infinite or negative there."""
    return np.where(denominator > 0, denominator, np.nan)


def shunt_strain(gauge_ohm: float, shunt_ohm: float, gauge_factor: float) -> float:
    """Return the strain, in m/m, that a resistor across a gauge simulates: compression, so it is negative.

    Raises
    ------
    SensorError
        If a number is not positive.
    """
    gauge, shunt = positive("gauge_ohm", gauge_ohm, "350.0"), positive("shunt_ohm", shunt_ohm, "174650.0")
    return -gauge / (positive("gauge_factor", gauge_factor, "2.1") * (gauge + shunt))


def gain_adjustment(simulated: float, read: float) -> float:
    """Return the factor that corrects the strain read with a shunt to the strain that the shunt simulates.

    Parameters
    ----------
    simulated : float
        Simulated strain, from `shunt_strain`, in m/m.
    read : float
        Strain read with the shunt minus strain read without it, without adjustment, in m/m.

    Raises
    ------
    SensorError
        If the two strains differ in sign or by more than a factor of two, which losses do not explain.

    Notes
    -----
    The factor corrects the losses in cables and amplifier, but not errors of the gauge, its glue or its place.
    """
    expected, measured = finite("simulated", simulated, "-952e-6"), finite("read", read, "-940e-6")
    if not (measured * expected > 0 and 0.5 <= expected / measured <= 2):
        raise SensorError(
            f"The shunt simulates {1e6 * expected:.6g} um/m and {1e6 * measured:.6g} um/m were read; no gain explains "
            "this ratio. Check the wiring, the resistance of the shunt and the configuration of the bridge."
        )
    return expected / measured
