"""Tune a smoother by cross-validation: by how well all other readings predict each reading. No truth is needed.

The likelihood measures how well a filter predicts the next reading; for a smoother it chooses too low an order. The
criterion here is mean((z - y)^2) / (1 - c g)^2, with the readings z, their estimates y, and the mean weight g = P/R of
a reading in its own estimate. With c = 1 this is generalised cross-validation. On short records that criterion
sometimes chooses a smoother that follows the noise. Therefore c exceeds 1 by 1 / sqrt(g N), the scatter of the
criterion; g N is the number of parameters that the smoother fits. Sources: Craven and Wahba, Numer. Math. 31 (1979)
377; Kim and Gu, J. R. Statist. Soc. B 66 (2004) 337, who take c = 1.4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import motion_power
from becalm.core.filter.channel import ChannelRecord
from becalm.core.model.components import EVERY_ORDER, motion
from becalm.identification.likelihood import Evidence, Tuning, find_ratio
from becalm.identification.spectrum import pooled, sine_spectrum, slope_between_ends

LONG, LEAST_COMPLETE = 4096, 0.8
"""Least number, and least share, of readings in complete stretches for a tuning from spectra alone.

With that many readings the ends of the stretches do not matter.
"""

_INDISTINCT = 2.0  # difference of loss times number of readings, up to which two orders count as equally good
_ALIKE = 0.1  # difference of log r that the readings of a few stretches cannot resolve
_OPAQUE = 0.95  # raised weight of a reading in its own estimate, from which on almost nothing is smoothed

Residuals = Callable[[float], tuple[float, float]]
"""Function of q/r that returns the mean squared residual, unit^2, and a reading's mean weight in its own estimate."""


def raised_weight(weight: float, count: int) -> float:
    """Return the mean weight of `count` readings in their own estimates, raised by the scatter of the criterion."""
    return float(weight * (1 + 1 / np.sqrt(max(weight * count, 1.0))))


def criterion(squares: float, weight: float, count: int) -> float:
    """Return the cross-validation criterion, the logarithm of a mean squared prediction error.

    The error is the distance of a reading from its prediction by all other readings.

    Parameters
    ----------
    squares : float
        Mean squared residual of the smoother, in unit^2.
    weight : float
        Mean weight of a reading in its own estimate; it is *small* for a smoother that smooths more.
    count : int
        Number of readings.

    Returns
    -------
    float
        The criterion; inf where almost nothing is smoothed, or the residuals are zero.
    """
    raised = raised_weight(weight, count)
    if not raised < _OPAQUE or not squares > 0:
        return np.inf
    return float(np.log(squares) - 2 * np.log1p(-raised))


def tune_smoother(evidence: Evidence) -> tuple[Tuning, ...]:
    """Tune a smoother of each order.

    Parameters
    ----------
    evidence : Evidence
        The readings, at least 8.

    Returns
    -------
    tuple of Tuning
        One for each order from 1 to 5 that can be tuned, with the criterion as `loss`; empty if none reduces the noise.
    """
    even = [evidence.z[part, 0] for part in _complete(evidence)]
    tunings = _tune_orders(evidence, residuals_from_spectra(even)) if even else ()
    if not stretches_for_spectra(evidence):
        tunings = _tune_orders(evidence, lambda order: residuals_by_smoothing(order, evidence), tunings)
    elif not tunings or not _is_confirmed(min(tunings, key=lambda tuning: tuning.loss), evidence):
        tunings = _tune_orders(evidence, lambda order: residuals_by_smoothing(order, evidence))
    least = evidence.smallest_variance
    return tuple(replace(tuning, noise_variance=max(tuning.noise_variance, least)) for tuning in tunings)


def simplest(tunings: Sequence[Tuning]) -> Tuning:
    """Return the tuning of the lowest order whose loss is not significantly above the least."""
    least = min(tuning.loss for tuning in tunings)
    return next(tuning for tuning in tunings if tuning.loss <= least + _INDISTINCT / tuning.count)


def stretches_for_spectra(evidence: Evidence) -> list[slice]:
    """Return the complete stretches if their spectra alone are enough for a tuning; otherwise an empty list."""
    complete = _complete(evidence)
    return complete if sum(part.stop - part.start for part in complete) >= LONG else []


def _complete(evidence: Evidence) -> list[slice]:
    """Return the complete stretches if they contain most of the readings; otherwise an empty list."""
    readings = sum(part.stop - part.start for part in evidence.complete)
    return evidence.complete if readings >= LEAST_COMPLETE * len(evidence.z) else []


def _tune_orders(
    evidence: Evidence, residuals: Callable[[int], tuple[Residuals, int]], hints: Sequence[Tuning] = ()
) -> tuple[Tuning, ...]:
    """Tune each order by the residuals of its smoothers; a search starts near the hint of its order, if any."""
    near = {hint.order: hint.ratio for hint in hints}
    steps = evidence.longest_steps
    tuned = []
    for order in EVERY_ORDER[: len(evidence.z) - 3]:
        order_residuals, count = residuals(order)
        if count:
            tuned.append(_minimise_criterion(order, steps, (order_residuals, count), near.get(order)))
    return tuple(tuning for tuning in tuned if tuning is not None)


def _is_confirmed(tuning: Tuning, evidence: Evidence) -> bool:
    """Return whether smoothing gives the same noise variance as the spectrum; not so if a record bends at its ends."""
    squares, weight = residuals_by_smoothing(tuning.order, evidence)[0](tuning.ratio)
    return abs(np.log(squares / (1 - weight) / tuning.noise_variance)) < _ALIKE if squares > 0 else False


def _minimise_criterion(
    order: int, steps: float, counted_residuals: tuple[Residuals, int], near: float | None
) -> Tuning | None:
    """Find the ratio of one order that minimises the criterion, first around `near`; None if it is nowhere finite."""
    residuals, count = counted_residuals

    least = find_ratio(order, lambda ratio: criterion(*residuals(ratio), count), steps, near=near)
    if not np.isfinite(least.cost):
        return None
    squares, weight = residuals(least.ratio)
    return Tuning(order, least.ratio, squares / (1 - weight), count, loss=least.cost, at_edge=least.at_edge)


def residuals_from_spectra(stretches: Sequence[Floats]) -> Callable[[int], tuple[Residuals, int]]:
    """Compute the residuals of smoothers from spectra, without smoothing.

    Parameters
    ----------
    stretches : sequence of (n,) float array
        Evenly sampled readings, in unit.

    Returns
    -------
    callable
        Function of the motion's order, 1 to 5. It returns `residuals`, a function of the ratio q/r that gives the mean
        squared residual, in unit^2, and the mean weight of a reading in its own estimate; and the number of readings.

    Notes
    -----
    A straight line is subtracted from each stretch before the sine transform. A smoother of order 2 or more follows
    that line. A smoother of order 1 departs from a line of slope s at both ends: k readings from an end, the
    difference is s / sqrt(q/r) exp(-sqrt(q/r) k).
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
    """Return the stretches with more readings than states; none if no stretch has the two more that a tuning needs."""
    parts = [part for part in evidence.sample if part.stop - part.start > states]
    return parts if any(part.stop - part.start > states + 1 for part in parts) else []


def residuals_by_smoothing(order: int, evidence: Evidence) -> tuple[Residuals, int]:
    """Compute the residuals of a smoother by smoothing.

    Parameters
    ----------
    order : int
        Order of the motion, 1 to 5.
    evidence : Evidence
        The readings. A record of more than 32768 is smoothed on sixteen pieces of 2048, a shorter one on all stretches
        with more than `order` readings, if at least one of them has more than `order` + 1.

    Returns
    -------
    residuals : callable
        Function of the ratio q/r that gives the mean squared residual, in unit^2, and the mean weight of a reading in
        its own estimate. Do not call it if `count` is 0.
    count : int
        Number of readings smoothed; 0 where all stretches are too short.
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
