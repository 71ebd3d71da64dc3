"""One search for the least of a cost: a grid over a logarithm, then Brent's method beside the best point.

A likelihood of a cut-off may have several maxima; the grid finds the region of the highest, and Brent's
method, which needs one valley only, its bottom. Source: Brent, Algorithms for Minimization without
Derivatives (1973), ch. 5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from becalm.core.arrays import Floats

Edge = Literal["", "low", "high"]
"""Whether a search ended at the lowest or the highest point of its grid, or between them."""

_SLOWEST_CYCLES = 0.2  # of the record: slower cut-offs are a polynomial
_FASTEST = 4.0  # radians a step: faster cut-offs pass everything
_AT_EDGE = 0.05  # of the distance between two points of the grid


class Least(NamedTuple):
    """Where a cost is least."""

    at: float
    cost: float  # inf if it is nowhere finite
    at_edge: Edge
    evaluations: int


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
