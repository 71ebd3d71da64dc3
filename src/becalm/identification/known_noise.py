"""Tune a motion model with noise that is already known, for instance because it was measured at rest.

R is fixed, so it is not concentrated out of the likelihood. The tuning of a causal filter maximises the likelihood, and
so does every tuning with coloured noise. The tuning of a smoother, where all noise is white, minimises its estimated
risk: with the mean squared residual s and the mean weight g of a reading in its own estimate, the mean squared error of
the estimate is s - R + 2 R g on average. This holds for any linear smoother, and needs no truth. On short records the
minimum sometimes belongs to a smoother that follows the noise; therefore `cross_validation.raised_weight` raises g.
Sources: Mallows, Technometrics 15 (1973) 661; Stein, Annals of Statistics 9 (1981) 1135; Schweppe, IEEE TIT-11 (1965)
61.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from becalm.core.filter.channel import Sums
from becalm.core.model.autoregressive import ColouredNoise
from becalm.core.model.components import EVERY_ORDER, ORDERS
from becalm.errors import RecordingError
from becalm.identification.coloured import score_coloured, start_of_first_run
from becalm.identification.cross_validation import (
    Residuals,
    raised_weight,
    residuals_by_smoothing,
    residuals_from_spectra,
    simplest,
    stretches_for_spectra,
)
from becalm.identification.likelihood import FEWEST_READINGS, Candidate, Evidence, Tuning, find_ratio

_ALIKE = 0.1  # difference of the logarithm of the mean squared residual that a few stretches cannot resolve


def tune_with_known_noise(
    evidence: Evidence, noise_variance: float, coloured: ColouredNoise | None = None, *, causal: bool
) -> Tuning:
    """Tune the order and the density of a motion model; the noise is known.

    Parameters
    ----------
    evidence : Evidence
        The readings, at least 8; evenly sampled if there is coloured noise.
    noise_variance : float
        R, the variance of a reading's white noise, in unit^2; a *small* one trusts the readings and smooths less.
    coloured : ColouredNoise or None
        Additional coloured noise, one step per reading; it is modelled as a disturbance.
    causal : bool
        True tunes a causal filter, False a smoother. Orders are 1 to 3, or 1 to 5 for a smoother without coloured
        noise.

    Raises
    ------
    RecordingError
        If there are fewer than 8 readings, or gaps cut them into stretches too short for a motion model.
    ModelError
        If a reading lies between two steps of the coloured noise, or its coefficients are not stationary.

    Notes
    -----
    The given noise is not checked: if a sensor is noisier in motion than at rest, the excess counts as motion. With
    coloured noise, a record of more than 32768 readings is scored on sixteen pieces of 2048.
    """
    if len(evidence.z) < FEWEST_READINGS:
        raise RecordingError(
            f"{len(evidence.z)} readings came; {FEWEST_READINGS} or more are needed for a motion. Give a longer record."
        )
    R = max(noise_variance, evidence.smallest_variance)
    if coloured is not None:
        tunings = [_tune_with_coloured(order, evidence, R, coloured) for order in ORDERS]
    elif causal:
        tunings = [_tune_with_white(order, evidence, R) for order in ORDERS]
    else:
        tunings = _tune_smoothers(evidence, R)
    if not any(tuning.count for tuning in tunings):
        raise RecordingError("No stretch of the record is long enough for a motion. Give a record with fewer gaps.")
    if coloured is None and not causal:
        return simplest(tunings)
    return max(tunings, key=lambda tuning: tuning.log_likelihood)


def _tune_with_white(order: int, evidence: Evidence, R: float) -> Tuning:
    """Find the likeliest density of one order for a known R.

    The log-likelihood of n readings at R is less than at the likeliest r by n (r/R - 1 - log(r/R)) / 2.
    """
    candidate = Candidate(order, evidence)

    def likelihood(ratio: float) -> tuple[float, int]:
        free = candidate.score(ratio)
        if not free.used:
            return -np.inf, 0
        excess = free.noise_variance / R
        return free.log_likelihood - 0.5 * free.used * (excess - 1 - np.log(excess)), free.used

    return _likeliest(likelihood, order, evidence, (R, R))


def _tune_with_coloured(order: int, evidence: Evidence, R: float, coloured: ColouredNoise) -> Tuning:
    """Find the likeliest density of one order for known white and coloured noise."""
    trial, parts = Tuning(order, 1.0, R, 0, coloured=coloured), _parts(evidence)

    def likelihood(ratio: float) -> tuple[float, int]:
        component = replace(trial, ratio=ratio).component
        total = Sums()
        for part in parts:
            total = total.plus(score_coloured(component, R, evidence.z[part], evidence.elapsed[part]) or Sums())
        return (total.log_likelihood, total.used) if total.used else (-np.inf, 0)

    tuning = _likeliest(likelihood, order, evidence, (R, R + coloured.variance))
    return replace(tuning, coloured=coloured)


def _likeliest(
    likelihood: Callable[[float], tuple[float, int]], order: int, evidence: Evidence, variances: tuple[float, float]
) -> Tuning:
    """Find the likeliest ratio q/r.

    `variances` are R and the variance of all noise, in unit^2. The grid of cut-offs is that of q over the latter.
    """
    R, total = variances
    least = find_ratio(order, lambda ratio: -likelihood(ratio * total / R)[0], evidence.longest_steps)
    ratio = least.ratio * total / R
    return Tuning(order, ratio, R, likelihood(ratio)[1], -least.cost, at_edge=least.at_edge)


def _tune_smoothers(evidence: Evidence, R: float) -> list[Tuning]:
    """Tune a smoother of each order for known white noise."""
    orders = EVERY_ORDER[: len(evidence.z) - 3]
    even = [evidence.z[part, 0] for part in stretches_for_spectra(evidence)]
    if even:
        residuals_by_order = list(map(residuals_from_spectra(even), orders))
        tunings = [
            _least_risk(order, *residuals, evidence, R)
            for order, residuals in zip(orders, residuals_by_order, strict=True)
        ]
        best = simplest(tunings)
        by_spectrum, _ = residuals_by_order[best.order - 1][0](best.ratio)
        by_smoothing, _ = residuals_by_smoothing(best.order, evidence)[0](best.ratio)
        if by_smoothing > 0 and abs(np.log(by_smoothing / by_spectrum)) < _ALIKE:
            return tunings
    every = {order: residuals_by_smoothing(order, evidence) for order in orders}
    return [_least_risk(order, *residuals, evidence, R) for order, residuals in every.items() if residuals[1]]


def _least_risk(order: int, residuals: Residuals, count: int, evidence: Evidence, R: float) -> Tuning:
    """Find the density at which the smoother of one order has the least estimated risk."""

    def loss(ratio: float) -> float:
        return log_prediction_error(*residuals(ratio), count, R)

    least = find_ratio(order, loss, evidence.longest_steps)
    return Tuning(order, least.ratio, R, count, loss=least.cost, at_edge=least.at_edge)


def log_prediction_error(squares: float, weight: float, count: int, noise_variance: float) -> float:
    """Return the logarithm of the sum of R and the estimated risk.

    The sum is the mean squared distance, in unit^2, of a new reading from the estimate.

    Parameters
    ----------
    squares, weight : float
        Mean squared residual of the smoother, in unit^2, and mean weight of a reading in its own estimate.
    count : int
        Number of readings.
    noise_variance : float
        R, in unit^2.
    """
    return float(np.log(squares + 2 * noise_variance * raised_weight(weight, count)))


def _parts(evidence: Evidence) -> list[slice]:
    """Return the pieces to score; each begins with a run of readings that is long enough to start the filter."""
    return [slice(part.start + start_of_first_run(evidence.elapsed[part]), part.stop) for part in evidence.sample]
