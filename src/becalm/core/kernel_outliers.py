"""Gross outliers: readings far from the median of six neighbours, where these lie close together.

A peak of motion, a shock or a step has neighbours that lead there, and that spread as wide. The lowest and the highest
neighbour do not count for the spread, so that one other outlier does not hide the first.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from becalm.core.arrays import Codes, Floats, Integers
from becalm.core.compiling import compiled, compiled_part
from becalm.core.sized import Size, size, stack_vector

NEIGHBOURS: Size = size(6)
COUNT = 6
SIDE = 3  # neighbours on each side
SPREADS = 8.0
"""Times the middle spread of its neighbours that a reading may be away from their median."""
IMPLAUSIBLE_SPREADS = 3.0
"""The same, of a reading that is not plausible: one beside a jump spreads its neighbours."""
FEWEST = 3  # neighbours

FILLED, LONGEST_FILL = 3, 64
"""Rows of one value, of a channel that hardly repeats any, that fill in for readings: longer ones may be a rest."""
NEARER = 4.0
"""Times that such a value need be less far away to be an outlier."""
NEAR_REST = 1.0 / 36.0
"""Of what is plausible, about a twelfth of what was read: so near to 0 is a channel before it rests there."""

AMID = 0.01  # of what was read: nearer to an end of it is no value amid

REACH = 256
"""Rows beyond which a reading is no neighbour."""

OUT, HELD = 1, 2
"""Why a reading is none, by those on both sides of it: it is an outlier, or else one of too many that are equal."""

Six = tuple[float, float, float, float, float, float]


class Outliers(NamedTuple):
    """How far readings of a channel jump."""

    distance: float = math.inf  # in unit, from the median of neighbours on both sides; inf finds none
    causal_distance: float = math.inf  # and of neighbours before; inf finds none
    low: float = -math.inf  # plausible first readings, in unit
    high: float = math.inf
    repeats_are_one: bool = False  # whether equal readings in a row count as one
    blank: float = math.inf  # what is written where there is no reading, in unit; inf where nothing is


@compiled_part
def middle_of(neighbours: Floats, count: int) -> tuple[float, float]:
    """Sort some neighbours; return their median, and the spread of all but the lowest and the highest."""
    for k in range(1, count):
        now, at = neighbours[k], k
        while at > 0 and neighbours[at - 1] > now:
            neighbours[at] = neighbours[at - 1]
            at -= 1
        neighbours[at] = now
    median = (neighbours[(count - 1) // 2] + neighbours[count // 2]) * 0.5
    return median, neighbours[count - 2] - neighbours[1]


@compiled_part
def is_far(reading: float, neighbours: Floats, count: int, distance: float, spreads: float) -> bool:
    """Return whether a reading is far from some neighbours, which are sorted in place, and so many of their spreads."""
    median, spread = middle_of(neighbours, count)
    return abs(reading - median) > max(spreads * spread, distance)


@compiled_part
def recall(past: Six, neighbours: Floats) -> int:
    """Fill in the readings before, NaN where there is none; return how many there are."""
    count = 0
    for one in past:
        if not math.isnan(one):
            neighbours[count] = one
            count += 1
    return count


@compiled_part
def is_far_from_past(reading: float, past: Six, rule: Outliers) -> bool:
    """Return whether a reading is far from the six before it, NaN where there are fewer; the last comes last.

    Of the first readings of all the plausible ones are believed, and two that agree.
    """
    a, b, c, d, e, f = past
    distance = rule.causal_distance
    low, high = min(min(min(a, b), min(c, d)), min(e, f)), max(max(max(a, b), max(c, d)), max(e, f))
    if not math.isnan(a) and high - distance <= reading <= low + distance:  # so near to each of them
        return False
    neighbours = stack_vector(NEIGHBOURS)
    count = recall(past, neighbours)
    if count >= FEWEST:
        return is_far(reading, neighbours, count, distance, SPREADS)
    return not (rule.low <= reading <= rule.high or abs(reading - f) <= distance)


@compiled_part
def is_filled_in(reading: float, past: Six, rule: Outliers) -> bool:
    """Return whether a reading that repeats the one before, the last of six, fills in for one that did not come."""
    neighbours = stack_vector(NEIGHBOURS)
    count = recall(past, neighbours)
    return count == COUNT and is_far(reading, neighbours, count, rule.causal_distance / NEARER, SPREADS)


@compiled_part
def gather(values: Floats, ends: Integers, run: int, runs: int, neighbours: Floats) -> tuple[int, int]:
    """Fill in the six nearest neighbours of a run; return how many, and how many more may come after the last run.

    `ends` tells the first and the last row of each run. Where one side has fewer than three, the other has more.
    """
    before, after = 0, 0
    while before < COUNT and run - before > 0 and ends[run, 0] - ends[run - before - 1, 1] <= REACH:
        before += 1
    while after < COUNT and run + after + 1 < runs and ends[run + after + 1, 0] - ends[run, 0] <= REACH:
        after += 1
    wanted = COUNT - min(before, SIDE)
    more = wanted - after if after < wanted and run + after + 1 == runs else 0
    left = min(before, COUNT - min(after, SIDE))
    right = min(after, COUNT - left)
    for k in range(left):
        neighbours[k] = values[run - 1 - k]
    for k in range(right):
        neighbours[left + k] = values[run + 1 + k]
    return left + right, max(more, 0)


@compiled_part
def find_runs(z: Floats, repeats_are_one: bool, values: Floats, ends: Integers) -> int:
    """Write the readings (N,) that are not NaN, a run of equal ones as one where they are; return how many."""
    runs = 0
    for row in range(len(z)):
        if math.isnan(z[row]):
            continue
        if repeats_are_one and runs and z[row] == values[runs - 1] and row - ends[runs - 1, 1] <= REACH:
            ends[runs - 1, 1] = row
            continue
        values[runs], ends[runs, 0], ends[runs, 1] = z[row], row, row
        runs += 1
    return runs


@compiled_part
def rests(neighbours: Floats, count: int, rule: Outliers) -> bool:
    """Return whether a 0 among some readings is one that a channel came to, as speeds and loads do."""
    nearest = math.inf
    for k in range(count):
        if neighbours[k] != 0.0:
            nearest = min(nearest, abs(neighbours[k]))
    return nearest == math.inf or nearest <= NEAR_REST * (rule.high - rule.low)


@compiled_part
def ends_at_0(rule: Outliers) -> bool:
    """Return whether a channel may end at 0: it is not amid what was read, the middle third of what is plausible."""
    third = (rule.high - rule.low) / 3.0
    return not (rule.low + (1.0 + AMID) * third < 0.0 < rule.high - (1.0 + AMID) * third)


@compiled
def mark_outliers(  # noqa: PLR0913  (a door for Python: what is read, how, room, what is written)
    z: Floats, begun: int, whole: bool, rule: Outliers, stuck: int, values: Floats, ends: Integers, far: Codes
) -> int:
    """Write OUT to `far` (N,) for each of the readings that is an outlier, by neighbours on both sides.

    Rows before `begun` are written already; the others come with 0. `values` (N,) and `ends` (N, 2) are room. To so
    many equal readings as `stuck` tells it writes HELD, from the first on, unless they are a rest; 0: any number may be
    equal. Return the first row that has to wait for later ones: none, so N, where the record is `whole`.
    """
    neighbours, runs = stack_vector(NEIGHBOURS), find_runs(z, rule.repeats_are_one, values, ends)
    for run in range(runs):
        first = ends[run, 0]
        if first < begun:
            found = far[first]
        else:
            count, more = gather(values, ends, run, runs, neighbours)
            if more and not whole and len(z) - 1 - first < REACH:
                return int(first)
            rows = 0
            for row in range(first, ends[run, 1] + 1):
                rows += not math.isnan(z[row])
            if run == runs - 1 and rows < max(FILLED, stuck) and not whole and len(z) - 1 - ends[run, 1] < REACH:
                return int(first)
            fills = stuck > 0 and FILLED <= rows <= LONGEST_FILL
            distance = rule.distance / NEARER if fills else rule.distance
            away = values[run] < rule.low or values[run] > rule.high
            if count >= FEWEST:
                spreads = IMPLAUSIBLE_SPREADS if away else SPREADS
                away = is_far(values[run], neighbours, count, distance, spreads)
            found = OUT if away else 0
            if not away and rows >= stuck > 0:
                past = values[max(run - COUNT, 0) : run]
                found = 0 if values[run] == 0.0 and ends_at_0(rule) and rests(past, len(past), rule) else HELD
        if found:
            for row in range(max(first, begun), ends[run, 1] + 1):
                far[row] = 0 if math.isnan(z[row]) else found
    return len(z)


@compiled
def measure_distances(values: Floats, ends: Integers, distances: Floats, spreads: Floats) -> None:
    """Write how far runs (N,) are from the median of their neighbours on both sides, and the spread of these."""
    neighbours = stack_vector(NEIGHBOURS)
    for run in range(len(values)):
        count, _ = gather(values, ends, run, len(values), neighbours)
        median, spreads[run] = middle_of(neighbours, count)
        distances[run] = abs(values[run] - median)


@compiled
def measure_jumps(z: Floats, jumps: Floats) -> None:
    """Write how far readings (N,) are from the median of the six before them, from the seventh on: `jumps` (N - 6,)."""
    neighbours = stack_vector(NEIGHBOURS)
    for row in range(len(jumps)):
        for k in range(COUNT):
            neighbours[k] = z[row + k]
        jumps[row] = abs(z[row + COUNT] - middle_of(neighbours, COUNT)[0])
