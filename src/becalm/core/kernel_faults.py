"""What is wrong with each reading itself, in one pass: impossible, at a rail, held for too long, far from its past."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.compiling import compiled, compiled_part
from becalm.core.kernel_outliers import (
    LONGEST_FILL,
    NEIGHBOURS,
    Outliers,
    Six,
    is_far_from_past,
    is_filled_in,
    recall,
    rests,
)
from becalm.core.sized import stack_vector

MISSING, NONFINITE, OVERRANGE, CLIPPED, STUCK, OUTLIER = 1, 2, 3, 6, 7, 13

HELD, RUN, LEAST, MOST, FAR, PAST = range(6)
"""What is remembered: the last reading, and how often it came in a row; the least and the greatest so far; whether the
last reading is an outlier; the last six readings, the last one last."""

MEMORY = PAST + 6

HOLDS = 2
"""Equal readings in a row that are called stuck where a channel holds its last reading: as `held.EVERY_REPEAT`."""
FILLS = 2.0
"""Of an outlier that is only one for as long as it may fill in for readings that did not come."""

Memory = tuple[float, float, float, float, float, Six]


class Rule(NamedTuple):
    """What the readings of a healthy channel keep to."""

    low: float  # the rails, in unit
    high: float
    largest: float  # magnitude of a reading that is possible
    stuck: int  # equal readings in a row; 0: never
    outliers: Outliers = Outliers()


def new_memory() -> Floats:
    """Return what is remembered before the first reading."""
    memory = np.full(MEMORY, np.nan)
    memory[HELD:PAST] = np.nan, 0.0, np.inf, -np.inf, 0.0
    return memory


@compiled_part
def load_memory(memory: Floats) -> Memory:
    """Return what an array remembers from its start on."""
    past = memory[PAST], memory[PAST + 1], memory[PAST + 2], memory[PAST + 3], memory[PAST + 4], memory[PAST + 5]
    return memory[HELD], memory[RUN], memory[LEAST], memory[MOST], memory[FAR], past


@compiled_part
def save_memory(now: Memory, memory: Floats) -> None:
    """Write what is remembered to an array."""
    memory[HELD], memory[RUN], memory[LEAST], memory[MOST], memory[FAR], past = now
    for k in range(6):
        memory[PAST + k] = past[k]


@compiled_part
def no_reading(reading: float, rule: Rule) -> int:
    """Return why a value is no reading of the sensor, 0 where it may be one."""
    if math.isnan(reading):
        return MISSING
    if math.isinf(reading):
        return NONFINITE
    if abs(reading) > rule.largest:
        return OVERRANGE
    return OUTLIER if reading == rule.outliers.blank else 0


@compiled_part
def is_rest(least: float, most: float, past: Six, rule: Outliers) -> bool:
    """Whether a 0 that ends the range so far is one at which the channel rests."""
    if least != 0.0 and most != 0.0:
        return False
    if not (rule.repeats_are_one and rule.causal_distance < math.inf):
        return True
    neighbours = stack_vector(NEIGHBOURS)
    return rests(neighbours, recall(past, neighbours), rule)


@compiled_part
def fault_of(reading: float, moved: bool, rule: Rule, memory: Memory) -> tuple[int, Memory]:
    """Return what is wrong with one reading, 0 for nothing, and what is remembered after it.

    A row of no time of its own says nothing new, unless it is the first. A 0 that ends the range so far is a rest.
    """
    code = no_reading(reading, rule)
    if code:
        return code, memory
    held, run, least, most, far, past = memory
    if rule.outliers.causal_distance < math.inf:
        if not (rule.outliers.repeats_are_one and reading == held):
            far = 1.0 if is_far_from_past(reading, past, rule.outliers) else 0.0
            if moved or run == 0.0:
                past = past[1], past[2], past[3], past[4], past[5], reading
        elif far != 1.0 and moved:
            may_fill = rule.stuck > HOLDS and run < LONGEST_FILL
            far = FILLS if may_fill and is_filled_in(reading, past, rule.outliers) else 0.0
    if moved or run == 0.0:
        run = run + 1.0 if reading == held else 1.0
        held, least, most = reading, min(least, reading), max(most, reading)
        if run >= rule.stuck > 0 and not (reading == 0.0 and is_rest(least, most, past, rule.outliers)):
            code = STUCK
    if far > 0.0:
        code = OUTLIER
    if reading <= rule.low or reading >= rule.high:
        code = CLIPPED
    return code, (held, run, least, most, far, past)


@compiled
def find_faults(z: Floats, elapsed: Floats, rule: Rule, memory: Floats, codes: Codes) -> int:
    """Write what is wrong with readings (B,) over what is wrong with their time; return how many codes are not 0."""
    now, found = load_memory(memory), 0
    for row in range(len(z)):
        code, now = fault_of(z[row], elapsed[row] > 0.0, rule, now)
        codes[row] = code if code else codes[row]
        found += codes[row] != 0
    save_memory(now, memory)
    return found
