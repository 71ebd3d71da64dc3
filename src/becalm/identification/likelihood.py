"""Maximum likelihood of a motion's tuning, with the noise variance concentrated out.

For a given ratio q/r the filter's gains are known, and the best r is the mean of nu^2 / S found with
r = 1; one number is left to search. Source: Harvey, Forecasting, Structural Time Series Models and
the Kalman Filter (1989), section 4.2; Schweppe, IEEE TIT-11 (1965) 61.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import returning_power
from becalm.core.filter.channel_record import ChannelRecord
from becalm.core.filter.likelihood_sums import Sums
from becalm.core.health.quantisation import converter_step
from becalm.core.model.autoregressive import ColouredNoise, autoregressive
from becalm.core.model.components import LEVEL_RATE, Component, motion, oscillator, returning_motion
from becalm.identification.search import Edge, find_ratio
from becalm.identification.spectrum import ToneOscillator

FEWEST_READINGS = 8
"""Fewer readings than this cannot tell noise from signal."""

UNSCORED = 3
"""Readings that only start the filter, for every order alike, so that likelihoods compare."""

LONG_GAP = 1000.0
"""Steps across which a motion is not followed for tuning: what it would predict says next to nothing."""

FEWEST_FOR_TONES = 256
"""Readings in even time, none missing, that tones are looked for in."""

LASTING = 1024
"""Readings in even time, none missing, whose spectrum is worth looking at."""

_SELDOM = 1.5  # steps between readings, from which on they have a rate of their own
_MOST_GAPS = 63
JITTER = 0.02
"""Steps by which a row may come late after the row before, in even time."""

_LATE = 0.1  # steps by which it may, beside an even clock
_PIECE, _PIECES = 2048, 16  # readings of a long record that stand for it
_FALLS = 3  # points downhill in a row after which slower cut-offs are not tried
_DEEP = 50.0  # and this much less likely


class Score(NamedTuple):
    """How well one tuning predicts."""

    log_likelihood: float
    noise_variance: float  # r, in unit^2
    used: int


@dataclass(frozen=True)
class Tuning:
    """A motion of one order, tuned, and perhaps tones beside it.

    Attributes
    ----------
    order : int
        Which derivative is driven by white noise.
    ratio : float
        q/r with q in unit^2/step^(2n-1): the density of that noise over the variance of a reading.
    noise_variance : float
        r, in unit^2.
    count : int
        Readings scored.
    log_likelihood : float
        Exact, of all readings but the first three, at this ratio and the likeliest noise variance for
        it; NaN where the motion was tuned for smoothing.
    loss : float
        Cross-validated, of a motion that was tuned for smoothing: `cross_validation.criterion`; NaN else.
    at_edge : {"", "low", "high"}
        Whether the search ended at its slowest or fastest filter; see `search.Edge`.
    lines : tuple of ToneOscillator
        Tones beside the motion.
    coloured : ColouredNoise or None
        Coloured noise beside the motion, a disturbance.
    damping : float
        Of the motion, radians a step, by which it returns to a level of its own; 0 of one that does not return.
    """

    order: int
    ratio: float
    noise_variance: float
    count: int
    log_likelihood: float = np.nan
    loss: float = np.nan
    at_edge: Edge = ""
    lines: tuple[ToneOscillator, ...] = ()
    coloured: ColouredNoise | None = None
    damping: float = 0.0

    def counted_in(self, steps: float) -> Tuning:
        """Return the same tuning where a step is so many of its own long.

        Parameters
        ----------
        steps : float
            Length of the new step in old ones, above 0; of a tuning with coloured noise, 1.
        """
        if steps == 1.0:
            return self
        assert self.coloured is None, "coloured noise is known at whole steps only"
        lines = tuple(
            line._replace(angle=line.angle * steps, damping=line.damping * steps, density=line.density * steps)
            for line in self.lines
        )
        ratio = self.ratio * steps ** (2 * self.order - 1)
        return replace(self, ratio=ratio, lines=lines, damping=self.damping * steps)

    @cached_property
    def component(self) -> Component:
        """The signal and what disturbs it, in steps."""
        return sum(self.companions, self.motion)

    @property
    def companions(self) -> list[Component]:
        """What is beside the motion, in steps: tones, and coloured noise."""
        tones = [_tone(line) for line in self.lines]
        if self.coloured is None:
            return tones
        return [*tones, autoregressive(self.coloured.coefficients, float(np.sqrt(self.coloured.variance)))]

    @cached_property
    def motion(self) -> Component:
        """The motion alone, in steps."""
        density = self.ratio * self.noise_variance
        if not self.damping:
            return motion(self.order, density)
        return returning_motion(self.order, density, self.damping)

    def motion_power(self, angle: Floats) -> Floats:
        """Return the power (k,), unit^2, of the motion at angles (k,) in radians a step, as it is read once a step."""
        return (
            self.ratio
            * self.noise_variance
            * returning_power(self.order, self.damping, LEVEL_RATE * self.damping, angle)
        )


def _tone(line: ToneOscillator) -> Component:
    tone = oscillator(line.angle / (2 * np.pi), line.damping / np.pi, line.density)
    return tone.as_disturbance() if line.disturbance else tone


@dataclass(frozen=True)
class Evidence:
    """Readings that arrived, and the time between them, ready to be scored.

    Attributes
    ----------
    z : (N, 1) float array
        Finite readings, in their unit.
    elapsed : (N,) float array
        Steps since the reading before.
    """

    z: Floats
    elapsed: Floats

    @classmethod
    def of(cls, readings: Floats, elapsed: Floats) -> Evidence:
        """Keep the finite readings (N,); time passes across the others."""
        seen = np.flatnonzero(np.isfinite(readings))
        times = np.cumsum(elapsed)[seen]
        whole = np.diff(times, prepend=times[:1])
        if np.array_equal(np.round(elapsed), elapsed):
            whole = np.round(whole)
        return cls(np.ascontiguousarray(readings[seen, np.newaxis]), whole)

    @cached_property
    def own_step(self) -> float:
        """How many steps readings mostly lie apart; 1 unless they come more seldom than every other row."""
        apart = float(np.quantile(self.elapsed[1:], 0.5, method="lower")) if len(self.elapsed) > 1 else 1.0
        return apart if _SELDOM <= apart <= LONG_GAP else 1.0

    def counted_in(self, steps: float) -> Evidence:
        """Return the same readings where a step is so many of its own long."""
        return self if steps == 1.0 else Evidence(self.z, self.elapsed / steps)

    @cached_property
    def stretches(self) -> list[slice]:
        """Rows between the longest gaps; across those nothing can be predicted, and each stretch starts anew."""
        long = np.flatnonzero(self.elapsed > LONG_GAP)
        long = np.sort(long[np.argsort(self.elapsed[long])[-_MOST_GAPS:]])
        bounds = [0, *long[long > 0].tolist(), len(self.z)]
        return [slice(start, stop) for start, stop in pairwise(bounds)]

    @cached_property
    def sample(self) -> list[slice]:
        """The stretches; of more than 32768 readings sixteen pieces of 2048, evenly spread."""
        if len(self.z) <= _PIECES * _PIECE:
            return self.stretches
        starts = np.linspace(0, len(self.z) - _PIECE, _PIECES).astype(int)
        return [slice(start, start + _PIECE) for start in starts.tolist()]

    @cached_property
    def longest_steps(self) -> float:
        """How many steps the longest stretch lasts, at least 4."""
        return max(4.0, *(float(self.elapsed[part][1:].sum()) for part in self.stretches))

    @cached_property
    def complete(self) -> list[slice]:
        """Long stretches of rows in even time but for a little jitter, none missing."""
        return [run for run in self.even if run.stop - run.start >= LASTING]

    @cached_property
    def even(self) -> list[slice]:
        """Stretches, long enough for tones, of rows in even time but for a little jitter, none missing."""
        uneven = np.abs(self.elapsed[1:] - 1.0) > JITTER
        bounds = np.flatnonzero(np.concatenate([[True], uneven, [True]]))
        runs = [slice(start, stop) for start, stop in pairwise(bounds.tolist()) if stop - start >= FEWEST_FOR_TONES]
        return [run for run in runs if keeps_time(self.elapsed[run][1:], np.ones(run.stop - run.start - 1))]

    def mean_step(self, part: slice) -> float:
        """Return how long a step of a stretch lasts on average, in steps."""
        return float(np.mean(self.elapsed[part][1:]))

    @cached_property
    def smallest_variance(self) -> float:
        """What rounding, of float64 and of a converter, alone leaves of a noise-free record, in unit^2."""
        largest = float(np.abs(self.z).max(initial=0.0))
        rounded = (np.finfo(float).eps * largest) ** 2 + float(np.finfo(float).tiny)
        return max(rounded, converter_step(self.z[:, 0]) ** 2 / 12)


class Candidate:
    """A motion of one order over a record, to be scored at any ratio q/r."""

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
    A grid over the logarithm of the cut-off finds the region, from the fastest downwards and until
    the likelihood has fallen far; Brent's method finds the maximum. Where no stretch holds four readings
    `count` is 0 and the likelihood -inf.
    """
    candidate = Candidate(order, evidence)

    def cost(ratio: float) -> float:
        return -candidate.score(ratio).log_likelihood

    found = find_ratio(order, cost, evidence.longest_steps, _has_risen)
    best = candidate.score(found.ratio)
    return Tuning(order, found.ratio, best.noise_variance, best.used, best.log_likelihood, at_edge=found.at_edge)


def keeps_time(elapsed: Floats, steps: Floats) -> bool:
    """Return whether rows, so many whole steps (N,) apart, keep to one even clock as time tells it, in steps (N,)."""
    late = np.cumsum(elapsed - steps * (elapsed.sum() / steps.sum()))
    return bool(np.abs(late).max() <= _LATE)


def _has_risen(costs: Sequence[float]) -> bool:
    """Whether the cost has risen for good, and far."""
    since = len(costs) - 1 - int(np.argmin(costs))
    rising = since >= _FALLS and all(a < b for a, b in pairwise(costs[-_FALLS - 1 :]))
    return rising and costs[-1] > min(costs) + _DEEP
