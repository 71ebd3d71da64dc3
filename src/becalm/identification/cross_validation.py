"""Tuning for smoothing: how well each reading is told by all others, which needs no truth.

The likelihood asks how well the next reading is foretold, and takes too low an order for a smoother.
Here the residuals of the smoother are weighed by what it keeps for noise: with the mean weight g of a
reading in its own estimate, P/R, the criterion is mean(z - y)^2 / (1 - c g)^2. With c = 1 that is
generalised cross-validation, whose minimum is now and then far too nervous on short records; c exceeds
1 by one over the square root of g N, the number of parameters that the smoother fits: the scatter
of the criterion itself. Source: Craven and Wahba, Numer. Math. 31 (1979) 377; Kim and Gu, J. R. Statist.
Soc. B 66 (2004) 337, who take c = 1.4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import motion_power
from becalm.core.filter.channel_record import ChannelRecord
from becalm.core.model.components import EVERY_ORDER, motion
from becalm.identification.likelihood import Evidence, Tuning
from becalm.identification.search import find_ratio
from becalm.identification.spectrum import pooled, sine_spectrum, slope_between_ends

LONG, MOST_OF = 4096, 0.8
"""Readings in complete stretches, and their share of all, from which on ends do not matter and spectra tell all."""

_NOT_TOLD = 2.0  # of twice a log-likelihood
_ALIKE = 0.1  # of the logarithm of r, as a few stretches tell it
_OPAQUE = 0.95  # weight of a reading in its own estimate, beyond which nothing is smoothed

Residuals = Callable[[float], tuple[float, float]]
"""At a ratio q/r: mean squared residual, and mean weight of a reading in its own estimate."""


def cautious(weight: float, count: int) -> float:
    """Return the mean weight of `count` readings, each in its own estimate, raised by its criterion's own scatter."""
    return float(weight * (1 + 1 / np.sqrt(max(weight * count, 1.0))))


def criterion(squares: float, weight: float, count: int) -> float:
    """Return the logarithm of what is minimised: of how far a reading lies from what all others say of it, squared.

    Parameters
    ----------
    squares : float
        Mean squared residual of the smoother, in unit^2.
    weight : float
        Mean weight of a reading in its own estimate; a *small* one smooths more, and is charged less.
    count : int
        Readings.

    Returns
    -------
    float
        inf where next to nothing is smoothed, or nothing is left.
    """
    charged = cautious(weight, count)
    if not charged < _OPAQUE or not squares > 0:
        return np.inf
    return float(np.log(squares) - 2 * np.log1p(-charged))


def tune_smoother(evidence: Evidence) -> tuple[Tuning, ...]:
    """Tune motions of every order for smoothing.

    Parameters
    ----------
    evidence : Evidence
        At least 8 readings.

    Returns
    -------
    tuple of Tuning
        One for each order from 1 to 5 that can be told, `loss` their criterion; none where no smoother removes noise.
    """
    even = [evidence.z[part, 0] for part in _complete(evidence)]
    found = _tuned(evidence, read_residuals(even)) if even else ()
    if not lasting(evidence):
        found = _tuned(evidence, lambda order: smooth_residuals(order, evidence), found)
    elif not found or not _confirmed(min(found, key=lambda tuning: tuning.loss), evidence):
        found = _tuned(evidence, lambda order: smooth_residuals(order, evidence))
    least = evidence.smallest_variance
    return tuple(replace(tuning, noise_variance=max(tuning.noise_variance, least)) for tuning in found)


def simplest(tunings: Sequence[Tuning]) -> Tuning:
    """Return the lowest order whose loss is not told from the least."""
    least = min(tuning.loss for tuning in tunings)
    return next(tuning for tuning in tunings if tuning.loss <= least + _NOT_TOLD / tuning.count)


def lasting(evidence: Evidence) -> list[slice]:
    """Return the stretches whose spectra tell all; none of a short record, or where too much is missing."""
    complete = _complete(evidence)
    return complete if sum(part.stop - part.start for part in complete) >= LONG else []


def _complete(evidence: Evidence) -> list[slice]:
    """Return the stretches in even time, if they hold most of the readings."""
    readings = sum(part.stop - part.start for part in evidence.complete)
    return evidence.complete if readings >= MOST_OF * len(evidence.z) else []


def _tuned(
    evidence: Evidence, residuals: Callable[[int], tuple[Residuals, int]], hints: Sequence[Tuning] = ()
) -> tuple[Tuning, ...]:
    """Tune every order by the residuals that its smoothers leave, first near a hint, such as the spectrum's."""
    near = {hint.order: hint.ratio for hint in hints}
    roads = {order: residuals(order) for order in EVERY_ORDER[: len(evidence.z) - 3]}
    steps = evidence.longest_steps
    found = [_least(order, steps, road, near.get(order)) for order, road in roads.items() if road[1]]
    return tuple(tuning for tuning in found if tuning is not None)


def _confirmed(tuning: Tuning, evidence: Evidence) -> bool:
    """Whether the smoother leaves what its spectrum foretold; not where a record bends sharply at its ends."""
    squares, weight = smooth_residuals(tuning.order, evidence)[0](tuning.ratio)
    return abs(np.log(squares / (1 - weight) / tuning.noise_variance)) < _ALIKE if squares > 0 else False


def _least(order: int, steps: float, road: tuple[Residuals, int], near: float | None) -> Tuning | None:
    """Find the ratio of one order that has the least criterion: near a hint, or, if it is not there, anywhere."""
    residuals, count = road

    found = find_ratio(order, lambda ratio: criterion(*residuals(ratio), count), steps, near=near)
    if not np.isfinite(found.cost):
        return None
    squares, weight = residuals(found.ratio)
    return Tuning(order, found.ratio, squares / (1 - weight), count, loss=found.cost, at_edge=found.at_edge)


def read_residuals(stretches: Sequence[Floats]) -> Callable[[int], tuple[Residuals, int]]:
    """Read the residuals of smoothers off spectra, without smoothing.

    Parameters
    ----------
    stretches : sequence of (n,) float array
        Readings in even time, in unit.

    Returns
    -------
    callable
        Of the order of the motion, 1 to 5: returns residuals, a function of the ratio q/r that gives the mean squared
        residual, in unit^2, and the mean weight of a reading in its own estimate; and how many readings they are of.

    Notes
    -----
    The line that the transform takes off is followed by every order but the first, which bends away at both ends,
    by s / sqrt(q/r) exp(-sqrt(q/r) k) where the slope is s.
    """
    spectrum = pooled([sine_spectrum(z) for z in stretches])
    readings = int(spectrum.weight.sum())

    def of_order(order: int) -> tuple[Residuals, int]:
        fixed, power = order * len(stretches), motion_power(order, spectrum.angle)
        slopes = float(sum(slope_between_ends(z) ** 2 for z in stretches)) if order == 1 else 0.0

        def residuals(ratio: float) -> tuple[float, float]:
            passed = ratio * power / (1 + ratio * power)
            lost = spectrum.weight * (1 - passed)
            squares = float(lost @ ((1 - passed) * spectrum.power)) + slopes * ratio**-1.5
            return squares / readings, 1 - (float(lost.sum()) - fixed) / readings

        return residuals, readings

    return of_order


def _parts(evidence: Evidence, states: int) -> list[slice]:
    """Return the stretches that are smoothed; none where each leaves one residual, which tells no two variances."""
    parts = [part for part in evidence.sample if part.stop - part.start > states]
    return parts if any(part.stop - part.start > states + 1 for part in parts) else []


def smooth_residuals(order: int, evidence: Evidence) -> tuple[Residuals, int]:
    """Smooth to find residuals.

    Parameters
    ----------
    order : int
        Of the motion, 1 to 5.
    evidence : Evidence
        Of more than 32768 readings sixteen pieces of 2048 are smoothed; of a short record all stretches of
        more than `order` readings, if one at least holds another one.

    Returns
    -------
    residuals : callable
        At a ratio q/r: the mean squared residual, in unit^2, and the mean weight of a reading in its own
        estimate. Not to be called where it is of none.
    count : int
        Readings that they are of; 0 where all stretches are too short.
    """
    unit, stretches = motion(order), [(evidence.z[part, 0], evidence.elapsed[part]) for part in _parts(evidence, order)]
    records = [ChannelRecord(unit, 1.0, z, elapsed) for z, elapsed in stretches]
    count = sum(len(z) for z, _ in stretches)

    def residuals(ratio: float) -> tuple[float, float]:
        squares = weight = 0.0
        for record, (z, _) in zip(records, stretches, strict=True):
            smoothed = record.smoothed(record.process_noise * ratio)
            squares += float(((z - smoothed.signal) ** 2).sum())
            weight += float(np.minimum(smoothed.sigma**2, 1.0).sum())
        return squares / count, weight / count

    return residuals, count
