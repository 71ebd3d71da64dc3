"""Find a rule for gross outliers from a record: how far the readings of a channel jump; outliers jump farther.

C code applies the rule to each reading: `native/outliers.c` for a file, `native/limits.h` for a stream.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Booleans, Codes, Floats, Integers, input_of
from becalm.core.reading_verdicts import Verdict
from becalm.native.library import SETTINGS
from becalm.native.scans import (
    SHORTEST_FILL,
    SPREADS,
    measure_distances,
    measure_jumps,
    scan_outliers,
)

# Find the value that marks missing readings in a log.

_FEWEST_MARKED, _SHARE = 20, 0.05  # least number and least share of readings that equal the marker
_FEWEST_VALUES = 16  # least number of different readings
_OFTENER, _NEIGHBOURS = 10.0, 5  # least count of the marker, over the median count of the 5 next values on each side
_RUN = 3  # nine in ten runs of the marker have this many rows or fewer
_MARKER_NOISES, _SPREADS = 4.0, 2.0  # least distance from readings around a marker, over their noise and difference
_PAIR_OF_NOISE = 0.6745 * np.sqrt(2.0)  # median distance of two readings, for white noise of variance 1


def find_blank(z: Floats) -> float:
    """Return the value that marks single missing readings; inf if there is none.

    The marker is far more frequent than the values next to it. The readings before and after a marker mostly agree with
    each other, and differ from the marker.

    Parameters
    ----------
    z : (N,) float array
        Finite readings, in unit, in order.
    """
    values, counts = np.unique(z, return_counts=True)
    if len(values) < _FEWEST_VALUES:
        return np.inf
    place = int(counts.argmax())
    blank, count = float(values[place]), int(counts[place])
    neighbours = np.delete(counts[max(place - _NEIGHBOURS, 0) : place + _NEIGHBOURS + 1], min(place, _NEIGHBOURS))
    if count < max(_FEWEST_MARKED, _SHARE * len(z), _OFTENER * float(np.median(neighbours))):
        return np.inf
    first, last = _runs_inside(z == blank)
    if not len(first) or np.quantile(last - first + 1, 0.9) > _RUN:
        return np.inf
    steps = np.abs(np.diff(z[z != blank]))
    noise = float(np.median(steps[steps > 0])) / _PAIR_OF_NOISE if (steps > 0).any() else np.inf
    before, after = z[first - 1], z[last + 1]
    least = np.maximum(_SPREADS * np.abs(after - before), _MARKER_NOISES * noise)
    return blank if np.mean(np.abs(blank - (before + after) / 2) > least) > 0.5 else np.inf


def _runs_inside(is_marker: Booleans) -> tuple[Integers, Integers]:
    """Return the first and the last row of each run of True (N,) that touches no end of the record."""
    edges = np.diff(is_marker.astype(np.int8), prepend=0, append=0)
    first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    inner = (first > 0) & (last < len(is_marker) - 1)
    return first[inner], last[inner]


class Outliers(NamedTuple):
    """A rule for gross outliers: readings far from the median of six neighbours that lie close together.

    The neighbours of a reading in a peak, a shock or a step are themselves part of this motion, so that their spread is
    as large as its distance from them. The spread leaves out the lowest and the highest neighbour, so that one outlier
    among them does not hide another.
    """

    distance: float = np.inf  # from the median of neighbours on both sides, in unit; inf: no outliers
    causal_distance: float = np.inf  # from the median of neighbours before, in unit; inf: no outliers
    low: float = -np.inf  # lowest plausible value of an estimate, and of a reading without neighbours, in unit
    high: float = np.inf  # highest plausible value, in unit
    repeats_are_one: bool = False  # whether equal readings in a row count as one
    blank: float = np.inf  # value that marks a missing reading, in unit; inf: no such value
    far_from_0: float = 0.0  # a 0 whose neighbours are all farther from 0 is not a reading, in unit; 0: every 0 is one

    @property
    def without_neighbours(self) -> Outliers:
        """Return the part of the rule that needs no neighbours: plausible range, and marker of missing readings."""
        return NO_OUTLIERS._replace(low=self.low, high=self.high, blank=self.blank)


NO_OUTLIERS = Outliers()
"""A rule that detects no outliers."""

MOST_OUTLIERS = 0.1
"""Largest share of outliers; more frequent readings are not exceptions."""

_FEWEST = 8  # least number of readings to measure jumps
_IMPOSSIBLE, _MOST_IMPOSSIBLE = 1000.0, 0.2  # distance beyond motion, over the interquartile range; largest share
_ALIKE = 2.0  # far readings are pulses of a signal if the ratio of the 90 % and 10 % quantiles of size is below this
_UNLIKELY = 3.0  # largest number of far readings in a row by chance, in sigmas above the expected number
_NOISES = 30.0  # smallest distance of a gross outlier, in standard deviations of the noise
_OF_NOISE, _LARGE_OF_NOISE = 0.745, 1.82  # median and 90 % quantile of the distance from neighbours, over noise sigma
_AS_FAR, _MOST_MOVE = 1 / 3, 0.1  # per outlier at a distance, at most 0.1 readings of motion reach a third of it
_NEARLY = 0.8  # least distance of a moving reading that may look like an outlier, over its neighbours' spread
_MANY, _NEARER = 8, 3.0  # with this many outliers, others may be nearer by this factor
_JUMPS = 2.0  # limit of a jump from earlier readings, over the largest such jump in the record
_HIDDEN = 0.1  # assumed number of outliers hidden in equally large motion, over the number detected
_RARE = 0.05  # largest number of runs of equal readings, over that of different readings, if a run counts as one
_FAR, _MOVES = 1 / 12, 6.0  # least `far_from_0`, over the range of the bulk of readings, and over the median step
_BULK = 0.01, 0.99  # quantiles that bound the bulk of the readings
_BY_CHANCE = 0.05  # largest expected number of readings rounded to 0, if 0 is not a reading
_SECOND = 1.732  # size of the second differences of white noise, over that of the first
_SEVERAL = 4  # least number of runs of 0 for the comparison of the readings before and after them
_AGREE, _MOSTLY = 0.25, 0.75  # largest difference of readings around runs of 0, over their mean; least share


def find_outlier_rule(z: Floats, *, held: bool = False, resolution: float = 0.0) -> Outliers:
    """Find the rule for gross outliers of a channel.

    Parameters
    ----------
    z : (N,) float array
        Finite readings, in unit, in order. Up to one in ten may be an outlier, or one in five if the outliers are
        beyond any motion. One value may mark missing readings.
    held : bool
        Whether the channel repeats its last reading while there is no new one.
    resolution : float
        The step between two codes, in unit; 0 if the readings do not lie on a lattice.

    Returns
    -------
    Outliers
        The rule; it detects no outliers if the record does not determine a distance.
    """
    blank = find_blank(z)
    seen = z[z != blank]
    repeats = np.zeros(len(seen), bool)
    repeats[1:] = seen[1:] == seen[:-1]
    runs = np.count_nonzero(repeats[1:] & ~repeats[:-1])  # number of runs of equal readings
    rests = _rests_at_0(seen)
    are_one = held or bool(runs < _RARE * np.count_nonzero(~repeats) and not rests)
    values = seen[~repeats] if held else _without_repeats(seen, repeats) if are_one else seen
    if len(values) < _FEWEST:
        return NO_OUTLIERS
    impossible = _find_impossible(values)
    if np.count_nonzero(impossible) > MOST_OUTLIERS / 2 * len(values):  # so many distort other distances
        values = values[~impossible]
    distance, kept = _separate_outliers(values)
    if not distance:
        return NO_OUTLIERS._replace(blank=blank)
    far = 0.0 if rests or blank == 0 else _far_from_0(seen, kept, resolution if are_one else np.inf)
    hidden = int(_HIDDEN * (len(values) - len(kept)))
    kept = kept[kept != 0] if far else kept
    jumps = measure_jumps(input_of(kept))
    largest = float(np.sort(jumps)[: max(len(jumps) - hidden, 1)].max(initial=0.0))
    causal = max(_JUMPS * largest, distance)
    low, high = np.sort(kept)[[hidden, -1 - hidden]].tolist()
    margin = max(high - low, causal)
    return Outliers(distance, causal, low - margin, high + margin, are_one, blank, far)


def _separate_outliers(values: Floats) -> tuple[float, Floats]:
    """Return the smallest distance of an outlier from its neighbours, in unit, and the readings without outliers.

    The distance is 0 if the readings (N,) do not determine it, or if there are too many outliers for exceptions.
    """
    if len(values) < _FEWEST:
        return 0.0, values
    distances, spreads = distances_of(values)
    distance = _least_distance(distances, spreads)
    kept = _without_outliers(values, distances, spreads, distance)
    too_many = len(values) - len(kept) > max(MOST_OUTLIERS * len(values), 1)
    return (0.0 if too_many or not distance < np.inf else distance), kept


def _find_impossible(values: Floats) -> Booleans:
    """Return which readings (N,) are beyond any motion: a thousand interquartile ranges from the median.

    Such outliers are single readings with different sizes, and are not in a row more often than by chance. Pulses of a
    signal have similar sizes, or last longer than a reading. If the far readings are pulses, or too many, the result is
    all False.
    """
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75)).tolist()
    away = np.abs(values - middle)
    far = away > _IMPOSSIBLE * (high - low)
    smallest, largest = np.quantile(away[far], (0.1, 0.9)).tolist() if far.any() else (0.0, 0.0)
    pairs, by_chance = np.count_nonzero(far[1:] & far[:-1]), far.mean() ** 2 * len(far)
    last = pairs > by_chance + _UNLIKELY * np.sqrt(by_chance)  # they last longer than a reading
    if high == low or last or far.mean() > _MOST_IMPOSSIBLE or largest <= _ALIKE * smallest:
        return np.zeros(len(values), bool)
    return np.asarray(far)


def _rests_at_0(z: Floats) -> bool:
    """Return whether 0 is too frequent for an exception, and outside the middle third of the other readings' range."""
    others = z[z != 0]
    if not len(others) or len(z) - len(others) <= MOST_OUTLIERS * len(z):
        return False
    low, high = np.quantile(others, (MOST_OUTLIERS / 10, 1 - MOST_OUTLIERS / 10)).tolist()
    return not low + (high - low) / 3 < 0 < high - (high - low) / 3


def _far_from_0(z: Floats, kept: Floats, resolution: float) -> float:
    """Return `Outliers.far_from_0`, in unit: a 0 whose neighbours are all farther from 0 is not a reading.

    The result is 0, and every 0 a reading, in each of these cases: there are few different readings; readings lie on
    both sides of 0; a reading before a 0 is near 0; the readings before and after several runs of 0 mostly differ;
    rounding may produce a 0; or equal readings do not count as one, and a reading is near 0 or 0 comes several times.

    Parameters
    ----------
    z : (N,) float array
        Readings in order, in unit.
    kept : (M,) float array
        The readings without outliers, in unit.
    resolution : float
        The step between two codes, in unit; inf if equal readings in a row do not count as one.
    """
    others = kept[kept != 0]
    if len(np.unique(others)) < _FEWEST_VALUES:
        return 0.0
    low, high = np.quantile(others, _BULK).tolist()
    if low < 0 < high:
        return 0.0
    far: float = max(_FAR * (high - low), _MOVES * _usual_step(others))
    near = int(np.count_nonzero(np.abs(others) <= far))
    by_chance = near * min(resolution / (2 * far), 1.0)  # expected number of readings that are rounded to 0
    measured = z[z != 0]
    after = np.cumsum(z != 0)[np.flatnonzero((z[1:] != 0) & (z[:-1] == 0))]  # index in `measured` after each run of 0
    before, after = measured[after[after > 0] - 1], measured[after[after > 0]]
    several = len(before) >= _SEVERAL
    agree = np.abs(after - before) <= _AGREE * np.abs(after + before) / 2
    if by_chance > _BY_CHANCE or (np.abs(before) <= far).any() or (several and np.mean(agree) < _MOSTLY):
        return 0.0
    if not near:  # no reading is near 0: take half of the smallest magnitude
        far = 0.0 if several and np.isinf(resolution) else 0.5 * float(np.abs(others).min())
    return far


def _usual_step(z: Floats) -> float:
    """Return the median step between readings (N,), in unit, without the contribution of a steady motion."""
    steps = np.diff(z)
    first, second = np.abs(steps[steps != 0]), np.abs(np.diff(steps)) / _SECOND
    usual = float(np.median(first))
    return min(usual, float(np.median(second[second > 0]))) if (second > 0).any() else usual


def _without_repeats(z: Floats, repeats: Booleans) -> Floats:
    """Return the readings without repeats and long runs, because the jump at the end of a long run is not motion."""
    first = np.flatnonzero(~repeats)
    rows = np.diff(np.append(first, len(z)))
    return z[first[rows < SHORTEST_FILL]]


def _without_outliers(values: Floats, distances: Floats, spreads: Floats, distance: float) -> Floats:
    """Return the readings without outliers; outliers are removed repeatedly, because one may hide its neighbour."""
    while (out := (distances > distance) & (distances > SPREADS * spreads)).any():
        values = values[~out]
        distances, spreads = distances_of(values)
    return values


def is_outlier(z: Floats, rule: Outliers) -> Booleans:
    """Return which readings (N,), NaN where missing, are gross outliers or equal the marker of missing readings."""
    return np.asarray((verdicts_from_neighbours(z, rule) == Verdict.OUTLIER) | (z == rule.blank))


def verdicts_from_neighbours(z: Floats, rule: Outliers, stuck: int = 0) -> Codes:
    """Return a verdict for each reading from its neighbours on both sides: `OUTLIER`, `STUCK` or `USED`.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit, NaN where missing.
    rule : Outliers
        The rule for outliers.
    stuck : int
        This many equal readings in a row are stuck; 0: any number may be equal.
    """
    codes, seen = np.zeros(len(z), np.int8), input_of(np.where(z == rule.blank, np.nan, z))
    scan_outliers(packed_rule(rule), seen, codes, distance=rule.distance, stuck=stuck, judged_rows=0, whole=True)
    return codes


def packed_rule(rule: Outliers) -> NDArray[np.void]:
    """Return the rule in C's settings struct."""
    settings = np.zeros((), SETTINGS)
    settings["plausible_low"], settings["plausible_high"] = rule.low, rule.high
    settings["repeats_are_one"], settings["outlier_distance"] = rule.repeats_are_one, rule.causal_distance
    settings["far_from_0"] = rule.far_from_0
    return settings


def distances_of(z: Floats) -> tuple[Floats, Floats]:
    """Return the distance of readings (N,) from the median of six neighbours, and the neighbours' spread, in unit."""
    return measure_distances(input_of(z))


def _least_distance(distances: Floats, spreads: Floats) -> float:
    """Return the least distance of an outlier from its neighbours, in unit, beyond noise and motion; 0 if unknown.

    A reading of an impact may also be far from neighbours with a small spread. But then other impacts, and the motion
    after them, have similar distances from neighbours with a large spread; so such distances are not evidence of
    outliers. If a record has many outliers, some are nearer to their neighbours, so the distance is reduced.
    """
    some = distances[distances > 0]
    if not len(some):
        return 0.0
    shares = 0.5, 1 - MOST_OUTLIERS
    usual, large = np.quantile(distances, shares, method="lower")
    least = float(max(_NOISES / _OF_NOISE * usual, _NOISES / _LARGE_OF_NOISE * large, _NOISES * some.min()))
    alone = distances > SPREADS * spreads
    least /= _NEARER if np.count_nonzero(alone & (distances > least)) >= _MANY else 1.0
    out = alone & (distances > least)
    candidates, motion = np.sort(distances[out]), np.sort(distances[~out & (distances > _NEARLY * spreads)])
    if not len(candidates):
        return least
    as_far = len(motion) - np.searchsorted(motion, _AS_FAR * candidates, side="right")
    surely = np.append(as_far <= _MOST_MOVE * np.arange(len(candidates), 0, -1), True)
    first = int(surely.argmax())
    if first == len(candidates):
        return max(least, 2 * float(candidates[-1]))
    return float(candidates[first - 1]) if first else least
