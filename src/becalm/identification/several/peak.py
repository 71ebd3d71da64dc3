"""Find the maximum of a log-likelihood of several unknowns, and its curvature there.

The search needs few evaluations and no derivatives. Changes of variances by factors of ten find the region; BFGS with
difference quotients climbs to the maximum. The curvature is measured by differences over a fraction of a standard
error, so that rounding does not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Booleans, Floats

LogLikelihood = Callable[[Floats], float]

_TEN = 0.5 * np.log(10.0)  # change of the log of a standard deviation for a factor of ten in its variance
_SWEEPS = 3  # most sweeps over all variances
_LIKELIER = 0.1  # least gain in log-likelihood for a step by a factor of ten
_DIFFERENCE = 1e-6  # step of a difference quotient, in units of a parameter
_NEAR = 1e-3  # precision of the maximum, in standard errors
_LONGEST = 0.5  # longest step of a parameter for the curvature, where the likelihood is flat
_STEP = 0.2  # step for the curvature, in standard errors
FAR = 14.0
"""Largest change of the logarithm of a standard deviation: a factor of 10^12 in its variance."""

NEGLIGIBLE_GAIN = 0.1
"""Possible gain in log-likelihood below which a point counts as a maximum; it is far within one standard error."""

_ROUNDS = 3  # most searches by BFGS; each is scaled by the curvature at the end of the previous one
_ROUND = 1e-6  # least curvature, as a share of the largest; a smaller one is due to rounding
_HOPELESS = 1e10  # cost where the log-likelihood is not finite


@dataclass(frozen=True, eq=False)
class Peak:
    """A maximum of a log-likelihood, and its curvature.

    Attributes
    ----------
    theta : (k,) float array
        Position of the maximum.
    value : float
        Log-likelihood at the maximum.
    information : (k, k) float array
        Minus the second derivative of the log-likelihood at the maximum.
    possible_gain : float
        Gain in log-likelihood that is expected of one more Newton step, or of one unit along a flat direction. It is
        near 0 at a maximum, and large if there is no maximum.
    """

    theta: Floats
    value: float
    information: Floats
    possible_gain: float


def scale_variances(log_likelihood: LogLikelihood, theta: Floats, logarithms: Booleans) -> Floats:
    """Multiply each variance in turn by ten or by a tenth, as long as the likelihood rises; return theta (k,)."""
    best, theta = log_likelihood(theta), theta.copy()
    for _ in range(_SWEEPS):
        before = best
        for i in np.flatnonzero(logarithms):
            for direction in (_TEN, -_TEN):
                step = direction * np.eye(len(theta))[i]
                while (value := log_likelihood(theta + step)) > best + _LIKELIER and abs(theta[i]) < FAR:
                    best, theta = value, theta + step
        if best == before:
            break
    return theta


def climb(log_likelihood: LogLikelihood, theta: Floats, readings: int) -> Peak:
    """Climb from theta (k,) to the maximum, and measure the curvature there.

    Parameters
    ----------
    log_likelihood : callable
        Function of k parameters, typically logarithms of standard deviations; -inf where undefined.
    theta : (k,) float array
        Starting point.
    readings : int
        Number of readings; the cost that is minimised is per reading.
    """
    base, scale = log_likelihood(theta), 2.0 * max(readings, 1)

    def cost(at: Floats) -> float:
        value = (base - log_likelihood(at)) / scale
        return value if np.isfinite(value) else _HOPELESS

    directions = np.eye(len(theta))
    for _ in range(_ROUNDS):
        theta = _descend(cost, theta, directions, _NEAR / np.sqrt(scale))
        hessian = curvature(cost, theta, 1 / np.sqrt(scale))
        theta, _ = _last_step(cost, theta, hessian)
        _, gain = _last_step(cost, theta, hessian)
        if scale * gain < NEGLIGIBLE_GAIN:
            break
        directions = _inverse_root(hessian)
    return Peak(theta, log_likelihood(theta), scale * hessian, scale * gain)


def _descend(cost: Callable[[Floats], float], theta: Floats, directions: Floats, near: float) -> Floats:
    """Minimise the cost from theta (k,) by BFGS along the columns of `directions` (k, k); return the end."""
    from scipy.optimize import minimize

    def moved(at: Floats) -> float:
        return cost(theta + directions @ at)

    def slope(at: Floats) -> Floats:
        here, steps = moved(at), _DIFFERENCE * np.eye(len(at))
        return np.array([(moved(at + step) - here) / _DIFFERENCE for step in steps])

    result = minimize(moved, np.zeros(len(theta)), jac=slope, method="BFGS", options={"gtol": near})
    return np.asarray(theta + directions @ result.x)


def curvature(cost: Callable[[Floats], float], top: Floats, step: float) -> Floats:
    """Return the second derivative (k, k) of a cost at `top` (k,), by differences.

    Notes
    -----
    The differences are taken over a fifth of `step`, a standard error, and over more where the cost is flat. Mixed
    terms come from f(a + b) + f(-a - b) - f(a) - f(-a) - f(b) - f(-b) + 2 f(0) = 2 f_ab + ....
    """
    k, here = len(top), cost(top)
    long_enough = [_lengthen(cost, top, direction, (_STEP * step) ** 2 / 4) for direction in _STEP * step * np.eye(k)]
    directions, sums = np.array([d for d, _ in long_enough]), np.array([both for _, both in long_enough])
    hessian = np.diag(sums - 2 * here)
    for i in range(k):
        for j in range(i):
            both = cost(top + directions[i] + directions[j]) + cost(top - directions[i] - directions[j])
            hessian[i, j] = hessian[j, i] = (both - sums[i] - sums[j] + 2 * here) / 2
    back = np.linalg.inv(directions)
    return np.asarray(back @ hessian @ back.T)


def _lengthen(cost: Callable[[Floats], float], top: Floats, direction: Floats, least: float) -> tuple[Floats, float]:
    """Double a step (k,) until the cost at its ends rises by `least`, or the step reaches `_LONGEST`.

    Return the step, and the sum of the costs at both of its ends.
    """
    here = cost(top)
    while True:
        both = cost(top + direction) + cost(top - direction)
        if both - 2 * here >= least or np.linalg.norm(direction) >= _LONGEST:
            return direction, both
        direction = 2 * direction


def _inverse_root(matrix: Floats) -> Floats:
    """Return a root (k, k) of the inverse of a curvature, with flat directions bounded."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors / np.sqrt(np.maximum(values, _ROUND * np.abs(values).max() + np.finfo(float).tiny)))


def _last_step(cost: Callable[[Floats], float], top: Floats, hessian: Floats) -> tuple[Floats, float]:
    """Take a Newton step from the end of the search, if it reduces the cost.

    Return the new point, and the expected reduction in cost by the step and along the flat directions.
    """
    directions = _DIFFERENCE * np.eye(len(top))
    slope = np.array([cost(top + direction) - cost(top - direction) for direction in directions]) / (2 * _DIFFERENCE)
    values, vectors = np.linalg.eigh(hessian)
    steep, along = values > 1e-6 * max(values.max(initial=0.0), 1e-6), vectors.T @ slope
    promised = 0.5 * float(np.sum(along[steep] ** 2 / values[steep])) + float(np.abs(along[~steep]).sum())
    ahead = top - vectors[:, steep] @ (along[steep] / values[steep])
    return ahead if cost(ahead) < cost(top) else top, promised


def half_drop_distance(log_likelihood: LogLikelihood, peak: Peak, direction: Floats) -> float:
    """Return the distance along a direction (k,) at which the log-likelihood has fallen by one half.

    The distance is inf if the log-likelihood does not fall that far. If it is a parabola, the distance is one standard
    error.
    """
    fallen, ahead = 0.0, 1e-3
    while peak.value - log_likelihood(peak.theta + ahead * direction) < 0.5:
        fallen, ahead = ahead, 2 * ahead
        if fallen > FAR:
            return float(np.inf)
    for _ in range(20):
        middle = (fallen + ahead) / 2
        far = peak.value - log_likelihood(peak.theta + middle * direction) >= 0.5
        fallen, ahead = (fallen, middle) if far else (middle, ahead)
    return ahead
