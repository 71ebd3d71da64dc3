"""The least of the IMU paper's cost, over Q/R or over R and Q.

The gain of a filter does not change when R, Q and the initial covariance are scaled together. So the
cost is a valley along Q/R = constant, on whose floor every point is as good as every other; a search in
R and Q stops at an arbitrary one. A search over Q/R alone asks what the cost can answer; R comes from
the record itself (`becalm.identification.rest.rest_noise`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import ModelError
from becalm.identification.search import Edge, find_least, log_cutoffs
from becalm.identification.several.step_spectrum import Cost, StepTrial

_POINTS_A_DECADE = 4
_PRECISION = 1e-3  # of log(Q/R)
_COST_PRECISION = 1e-6  # of the cost, relative
_MOST_EVALUATIONS = 400


@dataclass(frozen=True)
class StepTuning:
    """What a search found.

    Attributes
    ----------
    ratio : float
        Q/R, which sets the filter; a *small* one trusts the model and smooths more.
    noise_variance, process_variance : float
        R and Q, in unit^2; their common scale is what was given, or arbitrary.
    cost : Cost
        There.
    evaluations : int
        Filters tried.
    at_edge : {"", "low", "high"}
        Whether the search ended at its slowest or fastest filter; see `search.Edge`.
    """

    ratio: float
    noise_variance: float
    process_variance: float
    cost: Cost
    evaluations: int
    at_edge: Edge = ""


def tune_by_step(trial: StepTrial, noise_variance: float = 1.0) -> StepTuning:
    """Find the Q/R of least cost, by a grid over its logarithm and Brent's method about the best point.

    Parameters
    ----------
    trial : StepTrial
        The record and the step.
    noise_variance : float
        R, in unit^2, such as `noise_at_rest` measures it; Q comes on its scale. Without an initial
        covariance it does not change the ratio.
    """

    def cost(log_ratio: float) -> Cost:
        return trial.cost(noise_variance, float(np.exp(log_ratio)) * noise_variance)

    found = find_least(lambda log_ratio: cost(log_ratio).total, _log_ratios(trial), _PRECISION)
    ratio = float(np.exp(found.at))
    Q, tried = ratio * noise_variance, found.evaluations + 1
    return StepTuning(ratio, noise_variance, Q, cost(found.at), tried, found.at_edge)


def tune_by_simplex(trial: StepTrial, noise_variance: float, process_variance: float) -> StepTuning:
    """Search R and Q together as the paper did, by the simplex of Nelder and Mead.

    Parameters
    ----------
    trial : StepTrial
        The record and the step.
    noise_variance, process_variance : float
        Where to start, in unit^2, both positive; where on the floor of the valley the search ends
        depends on it. Not to be confused with `tune_by_step`, whose answer does not.

    Raises
    ------
    ModelError
        If a start is not positive.

    Notes
    -----
    Nelder and Mead, Computer Journal 7 (1965) 308, in the logarithms of R and Q, so that both stay
    positive.
    """
    from scipy.optimize import minimize

    if not (0 < noise_variance < np.inf and 0 < process_variance < np.inf):
        raise ModelError(f"R = {noise_variance} and Q = {process_variance}; the search starts from positive ones.")

    def total(logs: Floats) -> float:
        R, Q = np.exp(logs).tolist()
        return trial.cost(R, Q).total

    start = np.log([noise_variance, process_variance])
    near = _COST_PRECISION * total(start)
    found = minimize(
        total,
        start,
        method="Nelder-Mead",
        options={"xatol": _PRECISION, "fatol": near, "maxfev": _MOST_EVALUATIONS},
    )
    R, Q = np.exp(found.x).tolist()
    return StepTuning(Q / R, R, Q, trial.cost(R, Q), int(found.nfev) + 2)


def _log_ratios(trial: StepTrial) -> Floats:
    """Return log(Q/R) from cut-offs that average the record to those that pass everything.

    The cut-off of either model is sqrt(Q/R) rad/s or somewhat less.
    """
    cutoffs = log_cutoffs(len(trial.record), 2)
    decades = 2 * float(cutoffs[0] - cutoffs[-1]) / np.log(10)
    cutoffs = log_cutoffs(len(trial.record), int(np.ceil(_POINTS_A_DECADE * decades)) + 1)
    result: Floats = 2 * (cutoffs + np.log(trial.rate_hz))
    return result
