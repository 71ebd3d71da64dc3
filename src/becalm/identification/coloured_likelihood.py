"""The likelihood of readings in coloured noise, computed from their spectrum or by a filter.

Before the first reading nothing is known about a motion, but the distribution of coloured noise is: it is stationary,
with mean 0 and its own covariance. If its start were unknown too, the filter would need many readings to separate it
from the motion, and how many would depend on the coefficients, so that likelihoods could not be compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.channel import ChannelRecord, Sums
from becalm.core.model.autoregressive import ColouredNoise, autoregressive
from becalm.core.model.components import motion
from becalm.core.model.parts import Component
from becalm.identification.spectrum import pooled, sine_spectrum

HIGHEST_ORDER = 3
"""Highest order of coloured noise that is tried."""

UNSCORED = 6
"""Readings of each stretch that only start the filter, for every motion and noise model alike."""

_HALF_CYCLES = 8  # in a stretch; slower frequencies are left out
_BIN = 0.02  # width of a bin over its frequency

Misfit = Callable[["Shape"], tuple[float, float]]
"""Function of a `Shape`: minus twice its log-likelihood, and the likeliest factor for its variances."""


@dataclass(frozen=True)
class Shape:
    """A noise model up to a common factor: the ratios of its variances."""

    white: float
    drift: float  # density of the random walk, 1/step
    innovation: float = 0.0
    coefficients: tuple[float, ...] = ()

    @property
    def coloured(self) -> ColouredNoise:
        """The coloured part of the noise."""
        unit = ColouredNoise(self.coefficients, 1.0)
        return ColouredNoise(self.coefficients, self.innovation / unit.innovation_variance)


def spectral_misfit(parts: Sequence[Floats]) -> Misfit:
    """Return the misfit to the sine transforms of stretches, (n,) each, without holes.

    The lowest frequencies are left out.
    """
    spectra = [sine_spectrum(part) for part in parts]
    slowest = [np.full(len(s.angle), np.pi * _HALF_CYCLES / len(z)) for s, z in zip(spectra, parts, strict=True)]
    kept = pooled(spectra).angle >= np.concatenate(slowest)
    angle, power, weight = (own[kept] for own in pooled(spectra))
    _, place = np.unique(np.floor(np.log(angle) / _BIN), return_inverse=True)
    total = np.bincount(place, weight)
    angle, power = np.bincount(place, weight * angle) / total, np.bincount(place, weight * power) / total
    walk, readings = 1 / (4 * np.sin(angle / 2) ** 2), float(total.sum())
    waves = np.cos(np.multiply.outer(np.arange(HIGHEST_ORDER + 1), angle))

    def misfit(shape: Shape) -> tuple[float, float]:
        model = shape.white + shape.drift * walk
        if shape.coefficients:
            model = model + shape.innovation / (_squared(shape.coefficients) @ waves[: len(shape.coefficients) + 1])
        factor = float(total @ (power / model)) / readings
        return float(total @ np.log(model)) + readings * (np.log(factor) + 1), factor

    return misfit


def exact_misfit(parts: Sequence[Floats]) -> Misfit:
    """Return the misfit by the filter to stretches (n,) with holes, which are NaN."""
    records = [_record(part) for part in parts]

    def misfit(shape: Shape) -> tuple[float, float]:
        component = motion(1, shape.drift)
        if shape.coefficients:
            component += autoregressive(shape.coefficients, float(np.sqrt(shape.coloured.variance)))
        total = Sums()
        for z, elapsed in records:
            total = total.plus(score_coloured(component, shape.white, z, elapsed) or Sums())
        squares, log_det, used = total
        if not squares > 0:
            return np.inf, 0.0
        return log_det + used * (np.log(squares / used) + 1), squares / used

    return misfit


def score_coloured(component: Component, noise_variance: float, z: Floats, elapsed: Floats) -> Sums | None:
    """Return the likelihood sums of all but the first readings, with coloured noise that starts stationary.

    Returns None where the first readings do not determine the motion's state.

    Parameters
    ----------
    component : Component
        A motion with coloured noise, in steps.
    noise_variance : float
        R, in unit^2.
    z : (N, 1) float array
        Readings in unit, none missing.
    elapsed : (N,) float array
        Steps since the reading before, whole.
    """
    sums = ChannelRecord(component, noise_variance, z[:, 0], elapsed).score(UNSCORED)
    return sums if sums.used == len(z) - UNSCORED else None


def first_in_a_row(elapsed: Floats) -> int:
    """Return where the first run of readings starts that is long enough to start the filter; 0 if there is none."""
    even = np.convolve(elapsed[1:] == 1.0, np.ones(UNSCORED - 1), "valid") if len(elapsed) >= UNSCORED else np.zeros(0)
    whole = np.flatnonzero(even > UNSCORED - 1.5)
    return int(whole[0]) if len(whole) else 0


def _record(part: Floats) -> tuple[Floats, Floats]:
    """Return the finite readings (m, 1) and the steps (m,) between them, from the first long enough run on."""
    seen = np.flatnonzero(np.isfinite(part))
    elapsed = np.diff(seen, prepend=seen[0]).astype(np.float64)
    begin = first_in_a_row(elapsed)
    return np.ascontiguousarray(part[seen[begin:], np.newaxis]), elapsed[begin:]


def _squared(coefficients: tuple[float, ...]) -> Floats:
    """Return c (p + 1,) of |1 - sum phi_l exp(-i w l)|^2 = sum c_l cos(l w).

    `autoregressive_power` computes the same. A search evaluates it thousands of times at the same angles; with c it can
    use one table of cosines.
    """
    a = np.array([1.0, *(-phi for phi in coefficients)])
    lagged = np.correlate(a, a, "full")[len(a) - 1 :]
    return np.append(lagged[:1], 2 * lagged[1:])
