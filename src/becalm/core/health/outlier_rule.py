"""How far the readings of a channel jump, found from a record: what is farther is a gross outlier."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Booleans, Codes, Floats, input_of
from becalm.core.health.missing_marker import find_blank
from becalm.core.verdict import Verdict
from becalm.native.rows import SETTINGS
from becalm.native.scans import (
    SHORTEST_FILL,
    SPREADS,
    measure_distances,
    measure_jumps,
    scan_outliers,
)


class Outliers(NamedTuple):
    """How far readings of a channel jump; a gross outlier is far from the median of six neighbours that lie together.

    A peak of motion, a shock or a step has neighbours that lead there, and that spread as wide. The lowest and the
    highest neighbour do not count for the spread, so that one other outlier does not hide the first.
    """

    distance: float = np.inf  # in unit, from the median of neighbours on both sides; inf finds none
    causal_distance: float = np.inf  # and of neighbours before; inf finds none
    low: float = -np.inf  # plausible first readings, in unit
    high: float = np.inf
    repeats_are_one: bool = False  # whether equal readings in a row count as one
    blank: float = np.inf  # what is written where there is no reading, in unit; inf where nothing is
    far_from_0: float = 0.0  # in unit: a 0 whose neighbours are all farther away is no reading; 0: every 0 is one

    @property
    def without_neighbours(self) -> Outliers:
        """Return what it says of a reading by itself: what is plausible, and what is written for none."""
        return NO_OUTLIERS._replace(low=self.low, high=self.high, blank=self.blank)


NO_OUTLIERS = Outliers()
"""A rule that finds no outlier."""

MOST_OUTLIERS = 0.1
"""Share of the readings beyond which they are no exceptions."""

_FEWEST = 8  # readings that tell how far they jump
_NOISES = 30.0  # standard deviations of the noise that a gross outlier is away, at the least
_OF_NOISE, _LARGE_OF_NOISE = 0.745, 1.82  # of white noise: the median distance from neighbours, and that of one in ten
_AS_FAR, _MOST_MOVE = 1 / 3, 0.1  # times an outlier's distance, that hardly any reading of motion is away; their share
_NEARLY = 0.8  # times the spread of its neighbours that motion is away, which may be taken for an outlier
_MANY, _NEARER = 8, 3.0  # outliers, of which there are others that are so many times nearer
_JUMPS = 2.0  # times the largest jump of a record is beyond what it shows
_HIDDEN = 0.1  # of the outliers that were found, so many more are hidden beside motion that is as large
_RARE = 0.05  # share of readings that are as the one before
_FEWEST_VALUES = 16  # different readings, below which nothing is said of 0
_FAR, _MOVES = 1 / 12, 6.0  # parts of the range of most readings that are far from 0, and median steps, at the least
_BULK = 0.01, 0.99  # quantiles that most readings lie between
_BY_CHANCE = 0.05  # readings that rounding makes 0, at the most, where a 0 is none
_SECOND = 1.732  # second differences of white noise, over first ones
_SEVERAL = 4  # returns to 0 that tell what they are
_AGREE, _MOSTLY = 0.25, 0.75  # of their mean, that readings before and after a fill differ by, at the most; mostly


def find_outlier_rule(z: Floats, *, held: bool = False, resolution: float = 0.0) -> Outliers:
    """Find how far the readings of a channel jump.

    Parameters
    ----------
    z : (N,) float array
        Finite readings, in unit, in order; up to one in ten may be an outlier, and one value may fill in for none.
    held : bool
        Whether the channel holds its last reading where no new one comes.
    resolution : float
        The step between two codes, in unit; 0 where readings lie on no lattice.

    Returns
    -------
    Outliers
        It finds none where the record cannot tell.
    """
    blank = find_blank(z)
    seen = z[z != blank]
    repeats = np.zeros(len(seen), bool)
    repeats[1:] = seen[1:] == seen[:-1]
    runs = np.count_nonzero(repeats[1:] & ~repeats[:-1])  # of equal readings
    rests = _rests_at_0(seen)
    are_one = held or bool(runs < _RARE * np.count_nonzero(~repeats) and not rests)
    values = seen[~repeats] if held else _that_vary(seen, repeats) if are_one else seen
    if len(values) < _FEWEST:
        return NO_OUTLIERS
    distances, spreads = distances_of(values)
    distance = _least_distance(distances, spreads)
    kept = _without_outliers(values, distances, spreads, distance)
    if not 0 < distance < np.inf or len(values) - len(kept) > max(MOST_OUTLIERS * len(values), 1):
        return NO_OUTLIERS._replace(blank=blank)
    jumps, hidden = measure_jumps(input_of(kept)), int(_HIDDEN * (len(values) - len(kept)))
    largest = float(np.sort(jumps)[: max(len(jumps) - hidden, 1)].max(initial=0.0))
    causal = max(_JUMPS * largest, distance)
    low, high = np.sort(kept)[[hidden, -1 - hidden]].tolist()
    margin = max(high - low, causal)
    far = 0.0 if rests or blank == 0 else _far_from_0(seen, kept, resolution if are_one else np.inf)
    return Outliers(distance, causal, low - margin, high + margin, are_one, blank, far)


def _rests_at_0(z: Floats) -> bool:
    """Return whether 0 comes too often to be an exception, and does not lie in the middle third of what else comes."""
    others = z[z != 0]
    if not len(others) or len(z) - len(others) <= MOST_OUTLIERS * len(z):
        return False
    low, high = np.quantile(others, (MOST_OUTLIERS / 10, 1 - MOST_OUTLIERS / 10)).tolist()
    return not low + (high - low) / 3 < 0 < high - (high - low) / 3


def _far_from_0(z: Floats, kept: Floats, resolution: float) -> float:
    """Return how far from 0 the neighbours of a 0 have to be, in unit, for it to be no reading; 0 where it is one.

    It is one where readings are on both sides of it, lead to it, or mostly differ before and after it, where rounding
    may make it of others, and where readings repeat and it comes several times.

    Parameters
    ----------
    z : (N,) float array
        Readings in order.
    kept : (M,) float array
        Those that are no outliers.
    resolution : float
        The step between two codes, in unit; inf where equal readings in a row do not count as one.
    """
    others = kept[kept != 0]
    if len(np.unique(others)) < _FEWEST_VALUES:
        return 0.0
    low, high = np.quantile(others, _BULK).tolist()
    if low < 0 < high:
        return 0.0
    far: float = max(_FAR * (high - low), _MOVES * _usual_step(others))
    near = int(np.count_nonzero(np.abs(others) <= far))
    by_chance = near * min(resolution / (2 * far), 1.0)  # zeros, of so many readings in so many codes
    measured = z[z != 0]
    after = np.cumsum(z != 0)[np.flatnonzero((z[1:] != 0) & (z[:-1] == 0))]  # of `measured`, that which follows a 0
    before, after = measured[after[after > 0] - 1], measured[after[after > 0]]
    several = len(before) >= _SEVERAL
    agree = np.abs(after - before) <= _AGREE * np.abs(after + before) / 2
    if by_chance > _BY_CHANCE or (np.abs(before) <= far).any() or (several and np.mean(agree) < _MOSTLY):
        return 0.0
    if not near:  # half of what no reading passes
        far = 0.0 if several and np.isinf(resolution) else 0.5 * float(np.abs(others).min())
    return far


def _usual_step(z: Floats) -> float:
    """Return the median step between readings (N,) that is not their steady motion."""
    steps = np.diff(z)
    first, second = np.abs(steps[steps != 0]), np.abs(np.diff(steps)) / _SECOND
    usual = float(np.median(first))
    return min(usual, float(np.median(second[second > 0]))) if (second > 0).any() else usual


def _that_vary(z: Floats, repeats: Booleans) -> Floats:
    """Return readings without repeats, and without those that are held: how these jump is no motion."""
    first = np.flatnonzero(~repeats)
    rows = np.diff(np.append(first, len(z)))
    return z[first[rows < SHORTEST_FILL]]


def _without_outliers(values: Floats, distances: Floats, spreads: Floats, distance: float) -> Floats:
    """Return readings without outliers, and without those that hid behind others among their neighbours."""
    while (out := (distances > distance) & (distances > SPREADS * spreads)).any():
        values = values[~out]
        distances, spreads = distances_of(values)
    return values


def is_outlier(z: Floats, rule: Outliers) -> Booleans:
    """Return which readings (N,), NaN where missing, are gross outliers by their neighbours on both sides."""
    return np.asarray((beside_others(z, rule) == Verdict.OUTLIER) | (z == rule.blank))


def beside_others(z: Floats, rule: Outliers, stuck: int = 0) -> Codes:
    """Return what readings (N,), NaN where missing, are by those on both sides of them: `OUTLIER`, `STUCK` or `USED`.

    Stuck are so many equal ones in a row as `stuck` tells; 0: none are.
    """
    codes, seen = np.zeros(len(z), np.int8), input_of(np.where(z == rule.blank, np.nan, z))
    scan_outliers(plausible(rule), seen, codes, distance=rule.distance, stuck=stuck, begun=0, whole=True)
    return codes


def plausible(rule: Outliers) -> NDArray[np.void]:
    """Return what a rule says of readings, as C's settings."""
    settings = np.zeros((), SETTINGS)
    settings["plausible_low"], settings["plausible_high"] = rule.low, rule.high
    settings["repeats_are_one"], settings["outlier_distance"] = rule.repeats_are_one, rule.causal_distance
    settings["far_from_0"] = rule.far_from_0
    return settings


def distances_of(z: Floats) -> tuple[Floats, Floats]:
    """Return how far readings (N,) are from the median of six neighbours, and how far these lie apart."""
    return measure_distances(input_of(z))


def _least_distance(distances: Floats, spreads: Floats) -> float:
    """Return how far an outlier is from its neighbours, in unit: farther than noise, and than motion; 0 without either.

    An impact may be as far from neighbours that lie as close, but others of the same kind, or what follows it, are as
    far from neighbours that do not: there are no outliers among them. A record that has many has nearer ones as well.
    """
    some = distances[distances > 0]
    if not len(some):
        return 0.0
    shares = 0.5, 1 - MOST_OUTLIERS  # of few readings one may be an outlier
    usual, large = np.quantile(distances, shares, method="lower")
    least = float(max(_NOISES / _OF_NOISE * usual, _NOISES / _LARGE_OF_NOISE * large, _NOISES * some.min()))
    alone = distances > SPREADS * spreads
    least /= _NEARER if np.count_nonzero(alone & (distances > least)) >= _MANY else 1.0
    out = alone & (distances > least)
    found, motion = np.sort(distances[out]), np.sort(distances[~out & (distances > _NEARLY * spreads)])
    if not len(found):
        return least
    as_far = len(motion) - np.searchsorted(motion, _AS_FAR * found, side="right")
    surely = np.append(as_far <= _MOST_MOVE * np.arange(len(found), 0, -1), True)
    first = int(surely.argmax())
    if first == len(found):
        return max(least, 2 * float(found[-1]))
    return float(found[first - 1]) if first else least
