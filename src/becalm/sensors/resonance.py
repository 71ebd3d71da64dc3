"""Compute the response of a spring, mass and damper to acceleration, the model of every sensor with a proof mass.

At low frequencies the displacement of the mass is dx = (m/k) a; near sqrt(k/m) / 2 pi the mass resonates, and far above
it hardly responds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.checks import positive

_PERCENT = 100.0  # percent in 1


@dataclass(frozen=True)
class Resonance:
    """A second-order sensor.

    Attributes
    ----------
    natural_hz : float
        f_N, the resonance frequency without damping.
    damping_ratio : float
        zeta: 1 is critical, 0.7 has the flattest response, and most piezoelectric sensors have less than 0.05.

    Raises
    ------
    SensorError
        If the frequency is not positive, or the damping negative.
    """

    natural_hz: float
    damping_ratio: float

    def __post_init__(self) -> None:
        """Check the values."""
        positive("natural_hz", self.natural_hz, "5000.0")
        positive("damping_ratio", self.damping_ratio, "0.7", zero=True)

    @classmethod
    def of_spring(cls, stiffness_n_per_m: float, mass_kg: float, damping_ns_per_m: float) -> Resonance:
        """Return the sensor with a spring k, a mass m and a damper c: f_N = sqrt(k/m) / 2 pi, zeta = c / (2 sqrt(k m)).

        Raises
        ------
        SensorError
            If the spring or the mass is not positive, or the damper is negative.
        """
        k, m = positive("stiffness_n_per_m", stiffness_n_per_m, "1000.0"), positive("mass_kg", mass_kg, "1e-3")
        c = positive("damping_ns_per_m", damping_ns_per_m, "0.1", zero=True)
        return cls(float(np.sqrt(k / m) / (2 * np.pi)), float(c / (2 * np.sqrt(k * m))))

    @property
    def ringing_hz(self) -> float:
        """Return the frequency of free oscillation, f_N sqrt(1 - zeta^2), in Hz; NaN if zeta is 1 or more."""
        return float(self.natural_hz * np.sqrt(1 - self.damping_ratio**2)) if self.damping_ratio < 1 else np.nan

    def acceleration(self, displacement_m: Floats) -> Floats:
        """Return (k/m) dx (n,), in m/s^2, for displacements (n,) in m; accurate well below the natural frequency."""
        return np.asarray((2 * np.pi * self.natural_hz) ** 2 * displacement_m)

    def response(self, frequency_hz: Floats) -> tuple[Floats, Floats]:
        """Return magnitude (k,), 1 at 0 Hz, and phase (k,) in degrees, negative for a lag, at frequencies (k,) in Hz.

        Without damping the magnitude at the natural frequency is inf.
        """
        r = np.asarray(frequency_hz) / self.natural_hz
        real, imaginary = 1 - r**2, 2 * self.damping_ratio * r
        with np.errstate(divide="ignore"):
            magnitude = 1 / np.hypot(real, imaginary)
        return np.asarray(magnitude), np.asarray(-np.degrees(np.arctan2(imaginary, real)))

    def accurate_to_hz(self, percent: float) -> float:
        """Return the frequency, in Hz, up to which the error of amplitudes is at most `percent`.

        Raises
        ------
        SensorError
            If `percent` is not between 0 and 100.

        Notes
        -----
        With u = (f/f_N)^2 the magnitude equals a limit where u^2 + (4 zeta^2 - 2) u + 1 = 1 / limit^2.
        """
        error = positive("percent", percent, "5.0") / _PERCENT
        if not error < 1:
            raise SensorError(f"percent = {percent!r} is not an error of an amplitude; give less than 100, e.g. 5.0.")
        half = 1 - 2 * self.damping_ratio**2
        below = half + np.sqrt(half**2 - 1 + (1 - error) ** -2)  # positive, as the product of both roots is < 0
        above = half**2 - 1 + (1 + error) ** -2
        peaks = half > 0 and above >= 0
        first = half - np.sqrt(above) if peaks else below
        return float(self.natural_hz * np.sqrt(first))
