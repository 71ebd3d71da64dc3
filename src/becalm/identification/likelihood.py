"""Tune a motion model by maximum likelihood, with the noise variance concentrated out.

The ratio q/r determines the filter's gains. The likeliest r is the mean of nu^2 / S of a filter with r = 1. So only the
ratio is searched. Source: Harvey, Forecasting, Structural Time Series Models and the Kalman Filter (1989),
section 4.2; Schweppe, IEEE TIT-11 (1965) 61.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio, ratio_to_cutoff, returning_power
from becalm.core.filter.channel import ChannelRecord, Sums
from becalm.core.health.quantisation import converter_step
from becalm.core.model.autoregressive import ColouredNoise, autoregressive
from becalm.core.model.components import LEVEL_RATE, Component, motion, oscillator, returning_motion
from becalm.identification.spectrum import ToneOscillator

# Minimise a cost over one number: by a grid, then by Brent's method next to the best point.
#
# The number is the logarithm of a motion's cut-off, which determines q/r. The likelihood may have several maxima over
# the cut-off. The grid finds the region of the highest maximum, and Brent's method then finds the maximum itself.
# Source: Brent, Algorithms for Minimization without Derivatives (1973), ch. 5.

Edge = Literal["", "low", "high"]
"""Whether a search ended at the lowest or the highest point of its grid, or ("") between them."""

_SLOWEST_CYCLES = 0.2  # cycles per record of the slowest cut-off; with a slower one the estimate is a polynomial
_FASTEST = 4.0  # radians a step; a faster cut-off passes everything
_AT_EDGE = 0.05  # distance from an end of the grid up to which a point counts as at this end, in spacings of the grid
_POINTS = 17  # cut-offs in the grid
_PRECISION = 3e-3  # tolerance of the logarithm of the cut-off, far below its standard error


class Least(NamedTuple):
    """The minimum of a cost."""

    at: float  # argument of the cost at the minimum
    cost: float  # inf if the cost is nowhere finite
    at_edge: Edge
    evaluations: int


class LeastRatio(NamedTuple):
    """The ratio q/r that minimises a cost."""

    ratio: float
    cost: float  # inf if the cost is nowhere finite
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
        Length of the record in steps; the slowest cut-off has a fifth of a cycle in the record.
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


FEWEST_READINGS = 8
"""Least number of readings; fewer cannot separate noise from signal."""

UNSCORED = 3
"""Number of readings that only start the filter, equal for orders 1 to 3 so that likelihoods can be compared."""

LONG_GAP = 1000.0
"""Gap, in steps, at which tuning starts anew: a prediction across it would be almost worthless."""

FEWEST_FOR_TONES = 256
"""Least number of evenly sampled readings, none missing, for a search for tones."""

FEWEST_FOR_SPECTRUM = 1024
"""Least number of evenly sampled readings, none missing, for a useful spectrum."""

_LEAST_OWN_STEP = 1.5  # median time between two readings, in steps, from which on that time becomes the step
_MOST_GAPS = 63  # most gaps at which tuning starts anew
JITTER = 0.02
"""Steps by which the time between two rows of an even clock may differ from a whole number."""

_LATE = 0.1  # deviation of a row from the time of an even clock, in steps, that is allowed
_PIECE, _PIECES = 2048, 16  # readings in a piece, and pieces that represent a long record
_FALLS = 3  # falls of the log-likelihood in a row after which slower cut-offs are not tried, ...
_DEEP = 50.0  # ... if the log-likelihood is also so far below its maximum


class Score(NamedTuple):
    """The likelihood of one tuning, and the noise variance that maximises it."""

    log_likelihood: float
    noise_variance: float  # r, in unit^2
    used: int  # number of readings scored


@dataclass(frozen=True)
class Tuning:
    """A tuned motion model of one order, perhaps with tones and coloured noise.

    Attributes
    ----------
    order : int
        Order n of the motion: its n-th derivative is white noise.
    ratio : float
        q/r, the density of that white noise, in unit^2/step^(2n-1), over the noise variance of a reading.
    noise_variance : float
        r, the noise variance of a reading, in unit^2.
    count : int
        Number of readings scored.
    log_likelihood : float
        Exact log-likelihood of the readings scored, at this ratio and the known noise variance or, if none is known,
        the likeliest; NaN for a tuning with a `loss`.
    loss : float
        Criterion that a smoother's tuning minimises: `cross_validation.criterion` or, for known noise,
        `known_noise.log_prediction_error`; otherwise NaN.
    at_edge : {"", "low", "high"}
        Whether the search ended at its slowest ("low") or fastest ("high") filter; see `Edge`.
    tones : tuple of ToneOscillator
        Tones in addition to the motion.
    coloured : ColouredNoise or None
        Coloured noise in addition to the motion; it is a disturbance.
    damping : float
        Rate, in radians per step, at which the motion returns to a level of its own; 0 if it does not return.
    """

    order: int
    ratio: float
    noise_variance: float
    count: int
    log_likelihood: float = np.nan
    loss: float = np.nan
    at_edge: Edge = ""
    tones: tuple[ToneOscillator, ...] = ()
    coloured: ColouredNoise | None = None
    damping: float = 0.0

    def counted_in(self, steps: float) -> Tuning:
        """Return the same tuning in a new time step that is `steps` old steps long.

        Parameters
        ----------
        steps : float
            Length of the new step in old steps, above 0; must be 1 for a tuning with coloured noise.
        """
        if steps == 1.0:
            return self
        assert self.coloured is None, "coloured noise is known at whole steps only"
        tones = tuple(
            tone._replace(angle=tone.angle * steps, damping=tone.damping * steps, density=tone.density * steps)
            for tone in self.tones
        )
        ratio = self.ratio * steps ** (2 * self.order - 1)
        return replace(self, ratio=ratio, tones=tones, damping=self.damping * steps)

    @cached_property
    def component(self) -> Component:
        """Return the model of the signal and its disturbances, in steps."""
        return sum(self.companions, self.motion)

    @property
    def companions(self) -> list[Component]:
        """Return the models of the tones and of the coloured noise, in steps."""
        tones = [_tone(tone) for tone in self.tones]
        if self.coloured is None:
            return tones
        return [*tones, autoregressive(self.coloured.coefficients, float(np.sqrt(self.coloured.variance)))]

    @cached_property
    def motion(self) -> Component:
        """Return the motion model alone, in steps."""
        density = self.ratio * self.noise_variance
        if not self.damping:
            return motion(self.order, density)
        return returning_motion(self.order, density, self.damping)

    def motion_power(self, angle: Floats) -> Floats:
        """Return the power (k,), unit^2, of the motion, sampled once a step, at angles (k,) in radians per step."""
        return (
            self.ratio
            * self.noise_variance
            * returning_power(self.order, self.damping, LEVEL_RATE * self.damping, angle)
        )


def _tone(tone: ToneOscillator) -> Component:
    component = oscillator(tone.angle / (2 * np.pi), tone.damping / np.pi, tone.density)
    return component.as_disturbance() if tone.disturbance else component


@dataclass(frozen=True)
class Evidence:
    """The finite readings of one channel and the time between them, ready to be scored.

    Attributes
    ----------
    z : (N, 1) float array
        Finite readings, in their unit.
    elapsed : (N,) float array
        Time since the previous reading, in steps.
    """

    z: Floats
    elapsed: Floats

    @classmethod
    def of(cls, readings: Floats, elapsed: Floats) -> Evidence:
        """Return the finite ones of readings (N,), and the times between them."""
        seen = np.flatnonzero(np.isfinite(readings))
        times = np.cumsum(elapsed)[seen]
        whole = np.diff(times, prepend=times[:1])
        if np.array_equal(np.round(elapsed), elapsed):
            whole = np.round(whole)
        return cls(np.ascontiguousarray(readings[seen, np.newaxis]), whole)

    @cached_property
    def own_step(self) -> float:
        """Return the median time between two readings, in steps; 1 if the median is below 1.5 or above `LONG_GAP`."""
        apart = float(np.quantile(self.elapsed[1:], 0.5, method="lower")) if len(self.elapsed) > 1 else 1.0
        return apart if _LEAST_OWN_STEP <= apart <= LONG_GAP else 1.0

    def counted_in(self, steps: float) -> Evidence:
        """Return the same readings in a new time step that is `steps` old steps long."""
        return self if steps == 1.0 else Evidence(self.z, self.elapsed / steps)

    @cached_property
    def stretches(self) -> list[slice]:
        """Return the stretches of rows between the 63 longest gaps over `LONG_GAP`; the filter starts anew in each."""
        long = np.flatnonzero(self.elapsed > LONG_GAP)
        long = np.sort(long[np.argsort(self.elapsed[long])[-_MOST_GAPS:]])
        bounds = [0, *long[long > 0].tolist(), len(self.z)]
        return [slice(start, stop) for start, stop in pairwise(bounds)]

    @cached_property
    def sample(self) -> list[slice]:
        """Return the stretches or, if there are more than 32768 readings, sixteen evenly spread pieces of 2048."""
        if len(self.z) <= _PIECES * _PIECE:
            return self.stretches
        starts = np.linspace(0, len(self.z) - _PIECE, _PIECES).astype(int)
        return [slice(start, start + _PIECE) for start in starts.tolist()]

    @cached_property
    def longest_steps(self) -> float:
        """Return the duration of the longest stretch in steps, at least 4."""
        return max(4.0, *(float(self.elapsed[part][1:].sum()) for part in self.stretches))

    @cached_property
    def complete(self) -> list[slice]:
        """Return the stretches of `even` with at least `FEWEST_FOR_SPECTRUM` readings."""
        return [run for run in self.even if run.stop - run.start >= FEWEST_FOR_SPECTRUM]

    @cached_property
    def even(self) -> list[slice]:
        """Return the stretches of at least 256 rows, evenly sampled apart from a little jitter, with none missing."""
        uneven = np.abs(self.elapsed[1:] - 1.0) > JITTER
        bounds = np.flatnonzero(np.concatenate([[True], uneven, [True]]))
        runs = [slice(start, stop) for start, stop in pairwise(bounds.tolist()) if stop - start >= FEWEST_FOR_TONES]
        return [run for run in runs if keeps_time(self.elapsed[run][1:], np.ones(run.stop - run.start - 1))]

    def mean_step(self, part: slice) -> float:
        """Return the mean time between two readings of a stretch, in steps."""
        return float(np.mean(self.elapsed[part][1:]))

    @cached_property
    def smallest_variance(self) -> float:
        """Return the variance, unit^2, that rounding by float64 or a converter adds to a noise-free record."""
        largest = float(np.abs(self.z).max(initial=0.0))
        rounded = (np.finfo(float).eps * largest) ** 2 + float(np.finfo(float).tiny)
        return max(rounded, converter_step(self.z[:, 0]) ** 2 / 12)


class Candidate:
    """A motion model of one order and a record, to be scored at any ratio q/r."""

    def __init__(self, order: int, evidence: Evidence) -> None:
        self.order = order
        self.evidence = evidence
        unit = motion(order)
        self._records = [
            ChannelRecord(unit, 1.0, evidence.z[part, 0], evidence.elapsed[part]) for part in evidence.stretches
        ]

    def score(self, ratio: float) -> Score:
        """Return the likelihood at q/r = `ratio`, maximised over r."""
        total = Sums()
        for record in self._records:
            total = total.plus(record.score(UNSCORED, record.process_noise * ratio))
        squares, log_det, used = total
        if not used:
            return Score(-np.inf, 0.0, 0)
        r = max(squares / used, self.evidence.smallest_variance)
        return Score(Sums(used, log_det + used * np.log(r), used).log_likelihood, r, used)


def tune_motion(order: int, evidence: Evidence) -> Tuning:
    """Find the ratio q/r of one order by maximum likelihood.

    Parameters
    ----------
    order : int
        1 to 5.
    evidence : Evidence
        At least order + 4 readings.

    Notes
    -----
    A grid over the logarithm of the cut-off finds the region of the maximum. It starts at the fastest cut-off and ends
    when the likelihood has fallen far; Brent's method then finds the maximum. Where every stretch is too short to be
    scored, `count` is 0 and the log-likelihood -inf.
    """
    candidate = Candidate(order, evidence)

    def cost(ratio: float) -> float:
        return -candidate.score(ratio).log_likelihood

    least = find_ratio(order, cost, evidence.longest_steps, _has_risen)
    best = candidate.score(least.ratio)
    return Tuning(order, least.ratio, best.noise_variance, best.used, best.log_likelihood, at_edge=least.at_edge)


def keeps_time(elapsed: Floats, steps: Floats) -> bool:
    """Return whether rows follow one even clock, given measured times (N,) and whole steps (N,) between them."""
    late = np.cumsum(elapsed - steps * (elapsed.sum() / steps.sum()))
    return bool(np.abs(late).max() <= _LATE)


def _has_risen(costs: Sequence[float]) -> bool:
    """Return whether the cost has risen several times in a row, and far above its minimum."""
    since = len(costs) - 1 - int(np.argmin(costs))
    rising = since >= _FALLS and all(a < b for a, b in pairwise(costs[-_FALLS - 1 :]))
    return rising and costs[-1] > min(costs) + _DEEP
