"""Minimise a cost over one number: a grid over its logarithm, then Brent's method next to the best point.

The number is the cut-off of a motion, which determines its ratio q/r. The likelihood of a cut-off may have several
maxima; the grid finds the region of the highest. Brent's method, which needs a single valley, finds its bottom. Source:
Brent, Algorithms for Minimization without Derivatives (1973), ch. 5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio, ratio_to_cutoff

Edge = Literal["", "low", "high"]
"""Whether a search ended at the lowest or the highest point of its grid, or ("") between them."""

_SLOWEST_CYCLES = 0.2  # of the cut-off in the record; with a slower one the estimate is a polynomial
_FASTEST = 4.0  # radians a step; a faster cut-off passes everything
_AT_EDGE = 0.05  # of the grid's spacing
_POINTS = 17
_PRECISION = 3e-3  # of the logarithm of the cut-off: far below its standard error


class Least(NamedTuple):
    """The minimum of a cost."""

    at: float
    cost: float  # inf if it is nowhere finite
    at_edge: Edge
    evaluations: int


class LeastRatio(NamedTuple):
    """The ratio q/r that minimises a cost."""

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
    """Find the ratio q/r of a motion that minimises a cost.

    Parameters
    ----------
    order : int
        1 to 5.
    cost : callable
        Function of q/r, with q in unit^2/step^(2n-1); inf where the cost is undefined.
    steps : float
        Length of the record in steps; the slowest cut-off makes a fifth of a cycle in it.
    enough : callable, optional
        See `find_least`.
    near : float, optional
        A q/r to search around first; the whole grid is searched only if the minimum is not there.
    """

    def to_ratio(log_cutoff: float) -> float:
        return cutoff_to_ratio(order, float(np.exp(log_cutoff)))

    def least(points: Floats) -> Least:
        return find_least(lambda log_cutoff: cost(to_ratio(log_cutoff)), points, _PRECISION, enough)

    grid = log_cutoffs(steps, _POINTS)
    first_points = grid if near is None else np.log(ratio_to_cutoff(order, near)) + (grid[:3] - grid[1])
    minimum = least(first_points)
    if near is not None and (minimum.at_edge or not np.isfinite(minimum.cost)):
        minimum = least(grid)
    return LeastRatio(to_ratio(minimum.at), minimum.cost, minimum.at_edge)


def log_cutoffs(steps: float, points: int) -> Floats:
    """Return the logarithms of cut-offs, in radians per step, from the fastest to the slowest of the search.

    Parameters
    ----------
    steps : float
        Length of the record in steps.
    points : int
        Number of cut-offs.
    """
    return np.linspace(np.log(_FASTEST), np.log(2 * np.pi * _SLOWEST_CYCLES / steps), points)


def find_least(
    cost: Callable[[float], float],
    grid: Floats,
    precision: float,
    enough: Callable[[Sequence[float]], bool] | None = None,
) -> Least:
    """Find the minimum of a cost.

    Parameters
    ----------
    cost : callable
        Function of a number, such as the logarithm of a cut-off; inf where the cost is undefined.
    grid : (k,) float array
        Equally spaced points, ascending or descending, in the order in which they are tried.
    precision : float
        Tolerance of the number, far below the grid's spacing.
    enough : callable, optional
        Function of the costs so far; True skips the rest of the grid. By default all points are tried.
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
        bracket = grid[max(best - 1, 0) : best + 2]
        bounds = float(bracket.min()), float(bracket.max())
        with np.errstate(invalid="ignore"):  # where the cost is inf
            result = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": precision})
        tried += int(result.nfev)
        if result.fun <= least:
            at, least = float(result.x), float(result.fun)
    return Least(at, least, _edge(at, grid), tried)


def _edge(at: float, grid: Floats) -> Edge:
    """Return the end of the grid at which a point lies, "" for none."""
    near = _AT_EDGE * abs(float(grid[1] - grid[0]))
    return "low" if at < grid.min() + near else "high" if at > grid.max() - near else ""
