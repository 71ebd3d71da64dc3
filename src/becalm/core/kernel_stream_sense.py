"""The first pass over a stream's block: which readings may enter the filter, and where it starts anew."""

from __future__ import annotations

import math

from becalm.core.arrays import Codes, Floats, Integers
from becalm.core.compiling import compiled_part
from becalm.core.kernel_faults import OVERRANGE, Rule, fault_of, load_memory, save_memory
from becalm.core.kernel_outliers import Outliers
from becalm.core.kernel_stream_layout import (
    HIGH,
    IMPOSSIBLE,
    LARGEST,
    LAST,
    LONGEST,
    LOW,
    NOW,
    OUTLIERS,
    READINGS,
    SPANS,
    STUCK,
    TELLING,
)

_SHORTEST = 1e-300  # steps: no time at all, of which inf times is no number


@compiled_part
def sense(  # noqa: PLR0913
    fixed: Floats, z: Floats, elapsed: Floats, column: int, numbers: Floats, codes: Codes, usable: Floats
) -> None:
    """Write which readings of a column of z (B, m) are usable (B,), and what is wrong with the others."""
    outliers = Outliers(
        fixed[OUTLIERS], fixed[OUTLIERS + 1], fixed[OUTLIERS + 2], fixed[OUTLIERS + 3], fixed[OUTLIERS + 4] > 0.0,
        fixed[OUTLIERS + 5],
    )  # fmt: skip
    rule = Rule(fixed[LOW], fixed[HIGH], fixed[IMPOSSIBLE], int(fixed[STUCK]), outliers)
    memory = load_memory(numbers)
    for row in range(len(elapsed)):
        reading = z[row, column]
        code, memory = fault_of(reading, elapsed[row] > 0.0, rule, memory)
        if code == 0 and abs(reading) > fixed[LARGEST]:
            code = OVERRANGE
        usable[row] = reading if code == 0 else math.nan
        codes[row, column] = code if code else codes[row, column]
    save_memory(memory, numbers)


@compiled_part
def find_starts(fixed: Floats, usable: Floats, elapsed: Floats, numbers: Floats, marks: Integers, anew: Codes) -> None:  # noqa: PLR0913
    """Mark the readings (B,) before which a gap is beyond reach: the twin of `parted_flow`."""
    now, last, readings = numbers[NOW], numbers[LAST], marks[READINGS]
    for row in range(len(elapsed)):
        anew[row] = 0
        now += elapsed[row] if readings else 0.0
        if math.isnan(usable[row]):
            continue
        told = readings >= fixed[TELLING] and last > 0.0
        reach = min(fixed[LONGEST], fixed[SPANS] * max(last, _SHORTEST)) if told else fixed[LONGEST]
        if readings and now - last > reach:
            anew[row], now, readings = 1, 0.0, 0
        last, readings = now, readings + 1
    numbers[NOW], numbers[LAST], marks[READINGS] = now, last, readings
