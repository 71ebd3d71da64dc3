"""Innovations watched as they come: Page's sum on either side, and the sums of short hops, in one pass.

They are counted in whole parts of a sigma, so that every sum is exact, however the record is cut. What a hop's
power is may be far below one part; its sum goes on from row to row, and so does not depend on cuts either.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from becalm.core.arrays import Codes, Floats, Integers
from becalm.core.compiling import compiled, compiled_part

LARGEST = 6.0
"""Sigma: what one spike may say."""

PARTS = 1 << 16
"""Of a sigma."""

HOP = 16
"""Innovations that are summed together."""

KEPT_HOPS = 32
"""The last ones, whose power tells how large innovations are now."""

WINDOW = 64
"""Innovations whose variance is looked at together."""

DRIFT = 9

ABOVE, BELOW, ABOVE_SINCE, BELOW_SINCE, DRIFT_SINCE, ROWS, COUNT, TOTAL, SQUARES = range(9)
"""What is remembered: the sums of either side, and the row after the last in which each was 0; where the drift that
was told first began (-1: none was); rows so far; of the hop that is open, its innovations, their sum, their squares."""

MEMORY = 9

POWER, NOW, OPENED, SUMS = range(4)
"""What is remembered beside it: the power of the open hop, in sigma^2; the steps from the first row of all to the last,
and to that of the first innovation of the open hop."""


Sides = tuple[int, int, int, int]
"""The sums above and below, and the row after the last in which each was 0."""


class Hops(NamedTuple):
    """What is told of each whole hop."""

    totals: Integers  # (H,) in parts of a sigma
    squares: Integers  # (H,) in parts^2
    powers: Floats  # (H,) sums of squares, in sigma^2
    steps: Floats  # (H,) from the first row of all to that of its first innovation


@compiled_part
def cumulate(sides: Sides, part: int, row: int, slack: int, threshold: int) -> tuple[Sides, int]:
    """Add an innovation, in parts of a sigma, to the sums of either side: S = max(0, S + x - k) (Page 1954).

    Returns them with the row in which a drift that is told now began, -1 for none; then its sum starts anew.
    """
    above, below, above_since, below_since = sides
    above, below, since = max(above + part - slack, 0), max(below - part - slack, 0), -1
    if above >= threshold or below >= threshold:
        since = above_since if above >= threshold else below_since
        above, below = above if above < threshold else 0, below if below < threshold else 0
    above_since = row + 1 if above == 0 else above_since
    below_since = row + 1 if below == 0 else below_since
    return (above, below, above_since, below_since), since


@compiled
def watch(  # noqa: PLR0913  (a door for Python: what is read, what is remembered, what is written)
    normalised: Floats, elapsed: Floats, slack: int, threshold: int, memory: Integers, sums: Floats, hops: Hops,
    codes: Codes,
) -> int:  # fmt: skip
    """Watch innovations (B,) over their standard deviations, NaN where there is none; return how many hops ended.

    Where the sum of a side reaches the threshold, its row's code becomes DRIFT. `elapsed` are the steps before each
    row. `memory` and `sums` hold what was before, then after.
    """
    sides = memory[ABOVE], memory[BELOW], memory[ABOVE_SINCE], memory[BELOW_SINCE]
    count, total, squares, open_power = memory[COUNT], memory[TOTAL], memory[SQUARES], sums[POWER]
    before, now, opened, found = memory[ROWS], sums[NOW], sums[OPENED], 0
    for row in range(len(normalised)):
        now = now + elapsed[row] if before + row else 0.0
        nu = normalised[row]
        if math.isnan(nu):
            continue
        nu = min(max(nu, -LARGEST), LARGEST)
        part = round(nu * PARTS)
        sides, since = cumulate(sides, part, before + row, slack, threshold)
        if since >= 0:
            memory[DRIFT_SINCE] = since if memory[DRIFT_SINCE] < 0 else memory[DRIFT_SINCE]
            codes[row] = DRIFT
        opened = now if count == 0 else opened
        count, total, squares, open_power = count + 1, total + part, squares + part * part, open_power + nu * nu
        if count == HOP:
            hops.totals[found], hops.squares[found], hops.powers[found] = total, squares, open_power
            hops.steps[found] = opened
            count, total, squares, open_power, found = 0, 0, 0, 0.0, found + 1
    memory[ABOVE], memory[BELOW], memory[ABOVE_SINCE], memory[BELOW_SINCE] = sides
    memory[COUNT], memory[TOTAL], memory[SQUARES] = count, total, squares
    sums[POWER], sums[NOW], sums[OPENED] = open_power, now, opened
    memory[ROWS] = before + len(normalised)
    return found
