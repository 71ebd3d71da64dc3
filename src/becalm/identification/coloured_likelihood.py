"""The likelihood of readings in coloured noise: off their spectrum, or by a filter that begins as it has always been.

Of a motion nothing is known before the first reading; of coloured noise all that can be: it is
stationary, of mean 0 and its own covariance. Started as unknown, it would be told apart from the motion only
after many readings, and after as many as its coefficients happen to take, so that likelihoods would not compare.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.channel_record import ChannelRecord
from becalm.core.filter.likelihood_sums import Sums
from becalm.core.model.autoregressive import ColouredNoise, autoregressive
from becalm.core.model.components import motion
from becalm.core.model.parts import Component
from becalm.identification.spectrum import pooled, sine_spectrum

HIGHEST_ORDER = 3
"""Of coloured noise that is looked for."""

UNSCORED = 6
"""Readings of each stretch that only start the filter, whatever the motion and the noise."""

_HALF_CYCLES = 8  # of a stretch: what is slower is not looked at
_BIN = 0.02  # width of a bin over its frequency

Misfit = Callable[["Shape"], tuple[float, float]]
"""Of a shape of noise: minus twice its log-likelihood, and the likeliest factor that its variances take."""


@dataclass(frozen=True)
class Shape:
    """Noise but for a factor: variances beside one another."""

    white: float
    drift: float  # density of the random walk, 1/step
    innovation: float = 0.0
    coefficients: tuple[float, ...] = ()

    @property
    def coloured(self) -> ColouredNoise:
        """The coloured noise."""
        unit = ColouredNoise(self.coefficients, 1.0)
        return ColouredNoise(self.coefficients, self.innovation / unit.innovation_variance)


def spectral_misfit(parts: Sequence[Floats]) -> Misfit:
    """Read the misfit off the sine transforms of stretches, (n,) each, without holes; lowest frequencies left out."""
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
    """Find the misfit by the filter, of stretches (n,) with holes, NaN."""
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
    """Return what makes the likelihood of all but the first readings, coloured noise being stationary.

    None where the first readings do not tell the motion.

    Parameters
    ----------
    component : Component
        A motion with coloured noise beside it, in steps.
    noise_variance : float
        R, in unit^2.
    z : (N, 1) float array
        Readings, in unit, none missing.
    elapsed : (N,) float array
        Steps since the reading before, whole.
    """
    found = ChannelRecord(component, noise_variance, z[:, 0], elapsed).score(UNSCORED)
    return found if found.used == len(z) - UNSCORED else None


def first_in_a_row(elapsed: Floats) -> int:
    """Return the first of as many readings in a row as start the filter, or 0 if nowhere so many came."""
    even = np.convolve(elapsed[1:] == 1.0, np.ones(UNSCORED - 1), "valid") if len(elapsed) >= UNSCORED else np.zeros(0)
    whole = np.flatnonzero(even > UNSCORED - 1.5)
    return int(whole[0]) if len(whole) else 0


def _record(part: Floats) -> tuple[Floats, Floats]:
    """Return the readings (m, 1) that arrived and the steps (m,) between, from the first few in a row on."""
    seen = np.flatnonzero(np.isfinite(part))
    elapsed = np.diff(seen, prepend=seen[0]).astype(np.float64)
    begin = first_in_a_row(elapsed)
    return np.ascontiguousarray(part[seen[begin:], np.newaxis]), elapsed[begin:]


def _squared(coefficients: tuple[float, ...]) -> Floats:
    """Return c (p + 1,) of |1 - sum phi_l exp(-i w l)|^2 = sum c_l cos(l w).

    As `autoregressive_power` has it; but a search asks for it some thousand times at the same angles, of
    which a table of cosines is made once.
    """
    a = np.array([1.0, *(-phi for phi in coefficients)])
    lagged = np.correlate(a, a, "full")[len(a) - 1 :]
    return np.append(lagged[:1], 2 * lagged[1:])
