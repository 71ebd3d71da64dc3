"""One search for the least of a cost: a grid over a logarithm, then Brent's method beside the best point.

What is searched is the cut-off of a motion, and with it its ratio q/r.

A likelihood of a cut-off may have several maxima; the grid finds the region of the highest, and Brent's
method, which needs one valley only, its bottom. Source: Brent, Algorithms for Minimization without
Derivatives (1973), ch. 5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio, ratio_to_cutoff

Edge = Literal["", "low", "high"]
"""Whether a search ended at the lowest or the highest point of its grid, or between them."""

_SLOWEST_CYCLES = 0.2  # of the record: slower cut-offs are a polynomial
_FASTEST = 4.0  # radians a step: faster cut-offs pass everything
_AT_EDGE = 0.05  # of the distance between two points of the grid
_POINTS = 17
_PRECISION = 3e-3  # of the logarithm of the cut-off: far below its standard error


class Least(NamedTuple):
    """Where a cost is least."""

    at: float
    cost: float  # inf if it is nowhere finite
    at_edge: Edge
    evaluations: int


class LeastRatio(NamedTuple):
    """The ratio q/r of which a cost is least."""

    ratio: float
    cost: float  # inf if it is nowhere finite
    at_edge: Edge


def find_ratio(
    order: int,
    cost: Callable[[float], float],
    steps: float,
    enough: Callable[[Sequence[float]], bool] | None = None,
    near: float | None = None,
) -> LeastRatio:
    """Find the ratio q/r of a motion of which a cost is least.

    Parameters
    ----------
    order : int
        1 to 5.
    cost : callable
        Of q/r, with q in unit^2/step^(2n-1); inf where there is none.
    steps : float
        Length of the record, whose fifth of a cycle is the slowest cut-off.
    enough : callable, optional
        See `find_least`.
    near : float, optional
        The q/r beside which it is looked for first; elsewhere only if it is not there.
    """

    def at(log_cutoff: float) -> float:
        return cutoff_to_ratio(order, float(np.exp(log_cutoff)))

    def least(points: Floats) -> Least:
        return find_least(lambda log_cutoff: cost(at(log_cutoff)), points, _PRECISION, enough)

    grid = log_cutoffs(steps, _POINTS)
    beside = grid if near is None else np.log(ratio_to_cutoff(order, near)) + (grid[:3] - grid[1])
    found = least(beside)
    if near is not None and (found.at_edge or not np.isfinite(found.cost)):
        found = least(grid)
    return LeastRatio(at(found.at), found.cost, found.at_edge)


def log_cutoffs(steps: float, points: int) -> Floats:
    """Return the logarithms of cut-offs, radians a step, from those that pass everything to those that average all.

    Parameters
    ----------
    steps : float
        Length of the record.
    points : int
        How many.
    """
    return np.linspace(np.log(_FASTEST), np.log(2 * np.pi * _SLOWEST_CYCLES / steps), points)


def find_least(
    cost: Callable[[float], float],
    grid: Floats,
    precision: float,
    enough: Callable[[Sequence[float]], bool] | None = None,
) -> Least:
    """Find where a cost is least.

    Parameters
    ----------
    cost : callable
        Of a number, such as the logarithm of a cut-off; inf where there is none.
    grid : (k,) float array
        Points of equal distance, upwards or downwards, in the order in which they are tried.
    precision : float
        Of the number, far below the distance of two points.
    enough : callable, optional
        Told the costs so far, whether the rest of the grid may be left out; by default all is tried.
    """
    from scipy.optimize import minimize_scalar

    costs: list[float] = []
    for point in grid.tolist():
        costs.append(cost(point))
        if enough is not None and enough(costs):
            break
    best = int(np.argmin(costs))
    at, least, tried = float(grid[best]), costs[best], len(costs)
    if np.isfinite(least):
        beside = grid[max(best - 1, 0) : best + 2]
        bounds = float(beside.min()), float(beside.max())
        with np.errstate(invalid="ignore"):  # where the cost is inf
            found = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": precision})
        tried += int(found.nfev)
        if found.fun <= least:
            at, least = float(found.x), float(found.fun)
    return Least(at, least, _edge(at, grid), tried)


def _edge(at: float, grid: Floats) -> Edge:
    """Tell whether a point lies at an end of the grid."""
    near = _AT_EDGE * abs(float(grid[1] - grid[0]))
    return "low" if at < grid.min() + near else "high" if at > grid.max() - near else ""
