"""What is wrong with each reading itself, in one pass: impossible, at a rail, or held for too long."""

from __future__ import annotations

import math
from typing import NamedTuple

from becalm.core.arrays import Codes, Floats
from becalm.core.compiling import compiled, compiled_part

MISSING, NONFINITE, OVERRANGE, CLIPPED, STUCK = 1, 2, 3, 6, 7

HELD, RUN, LEAST, MOST = range(4)
"""What is remembered: the last reading, and how often it came in a row; the least and the greatest so far."""


Memory = tuple[float, float, float, float]


class Rule(NamedTuple):
    """What the readings of a healthy channel keep to."""

    low: float  # the rails, in unit
    high: float
    largest: float  # magnitude of a reading that is possible
    stuck: int  # equal readings in a row; 0: never


@compiled_part
def fault_of(reading: float, moved: bool, rule: Rule, memory: Memory) -> tuple[int, Memory]:
    """Return what is wrong with one reading, 0 for nothing, and what is remembered after it.

    A row of no time of its own says nothing new, unless it is the first. A 0 that ends the range so far is a rest.
    """
    held, run, least, most = memory
    if math.isnan(reading):
        return MISSING, memory
    if math.isinf(reading):
        return NONFINITE, memory
    if abs(reading) > rule.largest:
        return OVERRANGE, memory
    code = 0
    if moved or run == 0.0:
        run = run + 1.0 if reading == held else 1.0
        held, least, most = reading, min(least, reading), max(most, reading)
        rests = reading == 0.0 and (least == 0.0 or most == 0.0)
        if run >= rule.stuck > 0 and not rests:
            code = STUCK
    if reading <= rule.low or reading >= rule.high:
        code = CLIPPED
    return code, (held, run, least, most)


@compiled
def find_faults(z: Floats, elapsed: Floats, rule: Rule, memory: Floats, codes: Codes) -> int:
    """Write what is wrong with readings (B,) over what is wrong with their time; return how many codes are not 0."""
    now, found = (memory[HELD], memory[RUN], memory[LEAST], memory[MOST]), 0
    for row in range(len(z)):
        code, now = fault_of(z[row], elapsed[row] > 0.0, rule, now)
        codes[row] = code if code else codes[row]
        found += codes[row] != 0
    memory[HELD], memory[RUN], memory[LEAST], memory[MOST] = now
    return found
