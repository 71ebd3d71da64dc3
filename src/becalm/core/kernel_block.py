"""Which step precedes a row, and what no block of a settled gain may exceed."""

from __future__ import annotations

from becalm.core.compiling import compiled_part
from becalm.core.sized import Sizes, layer
from becalm.core.system import Record, Step, System

TAME = 1e190  # sum of squares; NaN, Inf and what no sensor reads are beyond it, as are states that run away


@compiled_part
def step_of(sizes: Sizes, system: System, number: int) -> Step:
    """Return one step of a system; the number of no step, -1, names the first."""
    n, m = sizes.states, sizes.channels
    number = max(number, 0)
    return Step(
        layer(system.F, number, n, n), layer(system.Q, number, n, n), layer(system.H, 0, m, n), layer(system.R, 0, m, m)
    )


@compiled_part
def run_of(record: Record, row: int, near: int) -> int:
    """Return the run of a row, looked for from a near one on."""
    while record.first[near + 1] <= row:
        near += 1
    while record.first[near] > row:
        near -= 1
    return near
