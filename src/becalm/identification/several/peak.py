"""The highest point of a log-likelihood of several unknowns, and how steeply it falls from there.

Few evaluations and no derivatives are asked for: a walk in factors of ten over the logarithms finds the
region, BFGS with differences climbs, and the curvature is measured about the top over steps of a
fraction of a standard error, so that rounding does not count.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Booleans, Floats

LogLikelihood = Callable[[Floats], float]

_TEN = 0.5 * np.log(10.0)  # of a variance, in the logarithm of its root
_SWEEPS = 3
_LIKELIER = 0.1  # by so much a factor of ten must be likelier to be gone
_DIFFERENCE = 1e-6
_NEAR = 1e-3  # of a standard error: where climbing ends
_LONGEST = 0.5  # of a logarithm, over which curvature is measured where the likelihood is flat
_STEP = 0.2  # of a standard error: over which curvature is measured
FAR = 14.0
"""How far a logarithm of a standard deviation is followed: a factor of 10^12 in its variance."""

AT_REST = 0.1
"""Of a log-likelihood: less than this above is a maximum, far within one standard error."""

_ROUNDS = 3
_ROUND = 1e-6  # of the largest curvature, which the least counts as at least
_HOPELESS = 1e10


@dataclass(frozen=True, eq=False)
class Peak:
    """A maximum.

    Attributes
    ----------
    theta : (k,) float array
        Where it is.
    value : float
        The log-likelihood there.
    information : (k, k) float array
        Minus its second derivative there.
    rising : float
        How much likelier it could still become, by a step of Newton's or one unit of a flat number; near 0
        if it is a maximum, and large where there is none.
    """

    theta: Floats
    value: float
    information: Floats
    rising: float


def walk(log_likelihood: LogLikelihood, theta: Floats, logarithms: Booleans) -> Floats:
    """Multiply one variance after the other by ten or a tenth, for as long as that is likelier."""
    best, theta = log_likelihood(theta), theta.copy()
    for _ in range(_SWEEPS):
        before = best
        for i in np.flatnonzero(logarithms):
            for way in (_TEN, -_TEN):
                step = way * np.eye(len(theta))[i]
                while (value := log_likelihood(theta + step)) > best + _LIKELIER and abs(theta[i]) < FAR:
                    best, theta = value, theta + step
        if best == before:
            break
    return theta


def climb(log_likelihood: LogLikelihood, theta: Floats, readings: int) -> Peak:
    """Climb from theta (k,) to the maximum, and measure its curvature.

    Parameters
    ----------
    log_likelihood : callable
        Of k numbers, of which a standard deviation's logarithm is typical; -inf where it cannot be.
    theta : (k,) float array
        Where to begin.
    readings : int
        How many there are; it sets the scale of the curvature.
    """
    base, scale = log_likelihood(theta), 2.0 * max(readings, 1)

    def cost(at: Floats) -> float:
        value = (base - log_likelihood(at)) / scale
        return value if np.isfinite(value) else _HOPELESS

    ways = np.eye(len(theta))
    for _ in range(_ROUNDS):
        theta = _descend(cost, theta, ways, _NEAR / np.sqrt(scale))
        bent = curvature(cost, theta, 1 / np.sqrt(scale))
        theta, _ = _last_step(cost, theta, bent)
        _, rising = _last_step(cost, theta, bent)
        if scale * rising < AT_REST:
            break
        ways = _inverse_root(bent)
    return Peak(theta, log_likelihood(theta), scale * bent, scale * rising)


def _descend(cost: Callable[[Floats], float], theta: Floats, ways: Floats, near: float) -> Floats:
    """Go down from theta (k,) by BFGS along `ways` (k, k); return where it ends."""
    from scipy.optimize import minimize

    def moved(at: Floats) -> float:
        return cost(theta + ways @ at)

    def slope(at: Floats) -> Floats:
        here, steps = moved(at), _DIFFERENCE * np.eye(len(at))
        return np.array([(moved(at + step) - here) / _DIFFERENCE for step in steps])

    found = minimize(moved, np.zeros(len(theta)), jac=slope, method="BFGS", options={"gtol": near})
    return np.asarray(theta + ways @ found.x)


def curvature(cost: Callable[[Floats], float], top: Floats, step: float) -> Floats:
    """Return the second derivative (k, k) of a cost, by differences over a fraction of `step`, longer where it is flat.

    Notes
    -----
    Mixed terms come from f(a + b) + f(-a - b) - f(a) - f(-a) - f(b) - f(-b) + 2 f(0) = 2 f_ab + ....
    """
    k, here = len(top), cost(top)
    long_enough = [_lengthen(cost, top, way, (_STEP * step) ** 2 / 4) for way in _STEP * step * np.eye(k)]
    ways, alone = np.array([way for way, _ in long_enough]), np.array([both for _, both in long_enough])
    bent = np.diag(alone - 2 * here)
    for i in range(k):
        for j in range(i):
            both = cost(top + ways[i] + ways[j]) + cost(top - ways[i] - ways[j])
            bent[i, j] = bent[j, i] = (both - alone[i] - alone[j] + 2 * here) / 2
    back = np.linalg.inv(ways)
    return np.asarray(back @ bent @ back.T)


def _lengthen(cost: Callable[[Floats], float], top: Floats, way: Floats, least: float) -> tuple[Floats, float]:
    """Double a way (k,) until the cost rises by enough to be seen beside rounding; return both costs added up."""
    here = cost(top)
    while True:
        both = cost(top + way) + cost(top - way)
        if both - 2 * here >= least or np.linalg.norm(way) >= _LONGEST:
            return way, both
        way = 2 * way


def _inverse_root(matrix: Floats) -> Floats:
    """Return a root (k, k) of the inverse of a curvature, with none of its directions lost."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors / np.sqrt(np.maximum(values, _ROUND * np.abs(values).max() + np.finfo(float).tiny)))


def _last_step(cost: Callable[[Floats], float], top: Floats, bent: Floats) -> tuple[Floats, float]:
    """Take Newton's step from where climbing ended, if it leads higher; return what it, or a flat way, promises."""
    ways = _DIFFERENCE * np.eye(len(top))
    slope = np.array([cost(top + way) - cost(top - way) for way in ways]) / (2 * _DIFFERENCE)
    values, vectors = np.linalg.eigh(bent)
    steep, along = values > 1e-6 * max(values.max(initial=0.0), 1e-6), vectors.T @ slope
    promised = 0.5 * float(np.sum(along[steep] ** 2 / values[steep])) + float(np.abs(along[~steep]).sum())
    ahead = top - vectors[:, steep] @ (along[steep] / values[steep])
    return ahead if cost(ahead) < cost(top) else top, promised


def reach(log_likelihood: LogLikelihood, peak: Peak, direction: Floats) -> float:
    """Return how far a direction (k,) leads until the log-likelihood has fallen by one half; inf if it does not.

    Half a unit is one standard error where the likelihood is a parabola.
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
