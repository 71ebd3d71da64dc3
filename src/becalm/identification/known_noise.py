"""A motion tuned beside noise that is known, as from rest.

What is known need not be found beside the motion: of the noise variance R nothing is concentrated out. A
causal filter is tuned by likelihood, and so is every motion beside coloured noise. A smoother beside white
noise is tuned by its estimated risk: with the mean squared residual s and the mean weight g of a
reading in its own estimate, the mean squared error of the estimate is s - R + 2 R g on average, without
truth and for any linear smoother. Being minimised, it is now and then too nervous on short records; so
g is taken with the caution of `cross_validation`. Sources: Mallows, Technometrics 15 (1973) 661; Stein,
Annals of Statistics 9 (1981) 1135; Schweppe, IEEE TIT-11 (1965) 61.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from becalm.core.filter.likelihood_sums import Sums
from becalm.core.model.autoregressive import ColouredNoise
from becalm.core.model.components import EVERY_ORDER, ORDERS
from becalm.errors import RecordingError
from becalm.identification.coloured_likelihood import first_in_a_row, score_coloured
from becalm.identification.cross_validation import (
    Residuals,
    cautious,
    lasting,
    read_residuals,
    simplest,
    smooth_residuals,
)
from becalm.identification.likelihood import FEWEST_READINGS, Candidate, Evidence, Tuning
from becalm.identification.search import find_ratio

_ALIKE = 0.1  # of the logarithm of the residuals, as a few stretches tell them


def tune_beside(
    evidence: Evidence, noise_variance: float, coloured: ColouredNoise | None = None, *, causal: bool
) -> Tuning:
    """Tune a motion, its order and its density, beside noise that is known.

    Parameters
    ----------
    evidence : Evidence
        At least 8 readings; beside coloured noise in even time.
    noise_variance : float
        R, of the white noise of one reading, in unit^2; a *small* one trusts the readings and smooths less.
    coloured : ColouredNoise or None
        Coloured noise beside it, one step a reading; a disturbance.
    causal : bool
        Whether the filter shall run causally. Orders are 1 to 3, but 1 to 5 of a smoother beside white noise.

    Raises
    ------
    RecordingError
        If fewer than 8 readings came, or gaps part them into stretches that tell no motion.
    ModelError
        If coloured noise is to be told between its steps, or its coefficients do not fade.

    Notes
    -----
    The noise is believed: where it was measured at rest and is louder in motion, more is taken for motion.
    Beside coloured noise, of more than 32768 readings sixteen stretches of 2048 are scored.
    """
    if len(evidence.z) < FEWEST_READINGS:
        raise RecordingError(
            f"{len(evidence.z)} readings came; {FEWEST_READINGS} or more tell a motion. Give a longer record."
        )
    R = max(noise_variance, evidence.smallest_variance)
    if coloured is not None:
        found = [_beside_coloured(order, evidence, R, coloured) for order in ORDERS]
    elif causal:
        found = [_beside_white(order, evidence, R) for order in ORDERS]
    else:
        found = _smoothers(evidence, R)
    if not any(tuning.count for tuning in found):
        raise RecordingError("No stretch of the record is long enough to tell a motion. Give one with fewer gaps.")
    if coloured is None and not causal:
        return simplest(found)
    return max(found, key=lambda tuning: tuning.log_likelihood)


def _beside_white(order: int, evidence: Evidence, R: float) -> Tuning:
    """Find the likeliest density of one order, R being known.

    At the likeliest r the log-likelihood is greater than at R by n (r/R - 1 - log r/R) / 2.
    """
    candidate = Candidate(order, evidence)

    def likelihood(ratio: float) -> tuple[float, int]:
        free = candidate.score(ratio)
        if not free.used:
            return -np.inf, 0
        beyond = free.noise_variance / R
        return free.log_likelihood - 0.5 * free.used * (beyond - 1 - np.log(beyond)), free.used

    return _likeliest(likelihood, order, evidence, (R, R))


def _beside_coloured(order: int, evidence: Evidence, R: float, coloured: ColouredNoise) -> Tuning:
    """Find the likeliest density of one order beside white and coloured noise."""
    trial, parts = Tuning(order, 1.0, R, 0, coloured=coloured), _parts(evidence)

    def likelihood(ratio: float) -> tuple[float, int]:
        component = replace(trial, ratio=ratio).component
        total = Sums()
        for part in parts:
            total = total.plus(score_coloured(component, R, evidence.z[part], evidence.elapsed[part]) or Sums())
        return (total.log_likelihood, total.used) if total.used else (-np.inf, 0)

    found = _likeliest(likelihood, order, evidence, (R, R + coloured.variance))
    return replace(found, coloured=coloured)


def _likeliest(
    likelihood: Callable[[float], tuple[float, int]], order: int, evidence: Evidence, variances: tuple[float, float]
) -> Tuning:
    """Search the ratio q/R; `variances` are R and that of all noise, beside which cut-offs are told."""
    R, total = variances
    least = find_ratio(order, lambda ratio: -likelihood(ratio * total / R)[0], evidence.longest_steps)
    ratio = least.ratio * total / R
    return Tuning(order, ratio, R, likelihood(ratio)[1], -least.cost, at_edge=least.at_edge)


def _smoothers(evidence: Evidence, R: float) -> list[Tuning]:
    """Tune smoothers of every order beside white noise."""
    orders = EVERY_ORDER[: len(evidence.z) - 3]
    even = [evidence.z[part, 0] for part in lasting(evidence)]
    if even:
        roads = list(map(read_residuals(even), orders))
        found = [_least_risk(order, *road, evidence, R) for order, road in zip(orders, roads, strict=True)]
        best = simplest(found)
        foretold, _ = roads[best.order - 1][0](best.ratio)
        smoothed, _ = smooth_residuals(best.order, evidence)[0](best.ratio)
        if smoothed > 0 and abs(np.log(smoothed / foretold)) < _ALIKE:
            return found
    every = {order: smooth_residuals(order, evidence) for order in orders}
    return [_least_risk(order, *road, evidence, R) for order, road in every.items() if road[1]]


def _least_risk(order: int, residuals: Residuals, count: int, evidence: Evidence, R: float) -> Tuning:
    """Find the density of one order whose smoother has the least estimated risk."""

    def loss(ratio: float) -> float:
        return foretold_square(*residuals(ratio), count, R)

    least = find_ratio(order, loss, evidence.longest_steps)
    return Tuning(order, least.ratio, R, count, loss=least.cost, at_edge=least.at_edge)


def foretold_square(squares: float, weight: float, count: int, noise_variance: float) -> float:
    """Return the logarithm of R plus the risk: of how far a fresh reading would lie from the estimate, squared.

    Parameters
    ----------
    squares, weight : float
        Mean squared residual, in unit^2, and mean weight of a reading in its own estimate.
    count : int
        Readings.
    noise_variance : float
        R, in unit^2.
    """
    return float(np.log(squares + 2 * noise_variance * cautious(weight, count)))


def _parts(evidence: Evidence) -> list[slice]:
    """Return what is scored, each part from the first few readings in a row on."""
    return [slice(part.start + first_in_a_row(evidence.elapsed[part]), part.stop) for part in evidence.sample]
