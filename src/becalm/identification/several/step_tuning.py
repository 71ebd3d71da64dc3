"""Minimise the IMU paper's cost, over Q/R or over R and Q.

The gain of a filter does not change when R, Q and the initial covariance are scaled together. So the cost over R and Q
is a valley with a level floor along Q/R = constant, and a search over both stops anywhere on this floor. The cost
determines Q/R alone; R comes from the record itself (`becalm.identification.at_rest.rest_noise`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import ModelError
from becalm.identification.likelihood import Edge, find_least, log_cutoffs
from becalm.identification.several.step_spectrum import Cost, StepTrial

_POINTS_A_DECADE = 4  # points of the grid per decade of Q/R
_PRECISION = 1e-3  # tolerance of log(Q/R)
_COST_PRECISION = 1e-6  # relative tolerance of the cost
_MOST_EVALUATIONS = 400  # most filters that the simplex tries


@dataclass(frozen=True)
class StepTuning:
    """The result of a search.

    Attributes
    ----------
    ratio : float
        Q/R, which sets the filter; a *small* one trusts the model and smooths more.
    noise_variance, process_variance : float
        R and Q, in unit^2. Their common scale is that of the given R, or arbitrary after a search over both.
    cost : Cost
        Cost at this R and Q.
    evaluations : int
        Number of filters tried.
    at_edge : {"", "low", "high"}
        Whether the search ended at its slowest ("low") or fastest ("high") filter; see `likelihood.Edge`.
    """

    ratio: float
    noise_variance: float
    process_variance: float
    cost: Cost
    evaluations: int
    at_edge: Edge = ""


def tune_by_step(trial: StepTrial, noise_variance: float = 1.0) -> StepTuning:
    """Find the Q/R of least cost, by a grid over its logarithm and Brent's method around the best point.

    Parameters
    ----------
    trial : StepTrial
        The record and the step.
    noise_variance : float
        R, in unit^2, for instance from `noise_at_rest`; Q is proportional to it. Without an initial covariance, R does
        not change the ratio.
    """

    def cost(log_ratio: float) -> Cost:
        return trial.cost(noise_variance, float(np.exp(log_ratio)) * noise_variance)

    least = find_least(lambda log_ratio: cost(log_ratio).total, _log_ratios(trial), _PRECISION)
    ratio = float(np.exp(least.at))
    Q, tried = ratio * noise_variance, least.evaluations + 1
    return StepTuning(ratio, noise_variance, Q, cost(least.at), tried, least.at_edge)


def tune_by_simplex(trial: StepTrial, noise_variance: float, process_variance: float) -> StepTuning:
    """Search R and Q together as the paper did, by the simplex of Nelder and Mead.

    Parameters
    ----------
    trial : StepTrial
        The record and the step.
    noise_variance, process_variance : float
        Starting point, in unit^2, both positive. The point on the floor of the valley at which the search ends depends
        on it; `tune_by_step` needs no starting point.

    Raises
    ------
    ModelError
        If one of them is not positive and finite.

    Notes
    -----
    The simplex (Nelder and Mead, Computer Journal 7 (1965) 308) moves in the logarithms of R and Q, so that both stay
    positive.
    """
    from scipy.optimize import minimize

    if not (0 < noise_variance < np.inf and 0 < process_variance < np.inf):
        raise ModelError(f"R = {noise_variance} and Q = {process_variance}; the search needs positive starting values.")

    def total(logs: Floats) -> float:
        R, Q = np.exp(logs).tolist()
        return trial.cost(R, Q).total

    start = np.log([noise_variance, process_variance])
    tolerance = _COST_PRECISION * total(start)
    result = minimize(
        total,
        start,
        method="Nelder-Mead",
        options={"xatol": _PRECISION, "fatol": tolerance, "maxfev": _MOST_EVALUATIONS},
    )
    R, Q = np.exp(result.x).tolist()
    return StepTuning(Q / R, R, Q, trial.cost(R, Q), int(result.nfev) + 2)


def _log_ratios(trial: StepTrial) -> Floats:
    """Return log(Q/R) from the slowest to the fastest filter of the search.

    The cut-off of either model is sqrt(Q/R) rad/s or somewhat less.
    """
    cutoffs = log_cutoffs(len(trial.record), 2)
    decades = 2 * float(cutoffs[0] - cutoffs[-1]) / np.log(10)
    cutoffs = log_cutoffs(len(trial.record), int(np.ceil(_POINTS_A_DECADE * decades)) + 1)
    result: Floats = 2 * (cutoffs + np.log(trial.rate_hz))
    return result
