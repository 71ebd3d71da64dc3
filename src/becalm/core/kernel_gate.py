"""Which readings of one channel no filter should believe: the row recursion with a gate before each update.

A gate only decides: it tells which readings to leave out, and before which of them the state has jumped.
What a filter makes of that is the business of the kernels that filter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from becalm.core.arrays import Codes, Floats
from becalm.core.compiling import compiled, compiled_part
from becalm.core.kernel_block import run_of, step_of
from becalm.core.kernel_settling import LOAD, SAVE, transfer_matrix, transfer_vector
from becalm.core.kernel_steps import State, correct, joseph, look, new_state, predict, weigh
from becalm.core.sized import Size, Sizes, size, stack_vector
from becalm.core.system import Record, Step, System

COUNTERS: Size = size(6)
REJECTED, AGREEING, LAST, WANDERED, SINCE, JUMPED = range(6)
"""Rejects in a row; how many of the last agree; the last innovation rejected, and how far the prediction may have
wandered since; readings used since the last jump, below 0 while all are believed: after a jump of
all states they have to tell what it forgot; whether there was a jump at all."""

USED, SPIKE, STEP = 0, 4, 5

GOES_ON = 16.0
"""Readings used since a jump, before which a reject is the same motion that goes on, and believed at once."""

WIDE = 1e9
"""Variances of all states over that of a reading, beyond which a covariance loses the digits of the readings."""


class Rule(NamedTuple):
    """When a reading is rejected, and when rejects are believed."""

    threshold: float  # z: of |innovation| over its standard deviation
    agree: int  # rejects in a row that agree: the signal has jumped
    at_most: int  # rejects in a row, whatever they are
    level: int  # the state that a jump adds to; -1 where all of them take part


@compiled_part
def wander(sizes: Sizes, step: Step, P: Floats) -> float:
    """Return by how much a prediction's error may change over a step, one standard deviation."""
    n, g, s = len(sizes.states), stack_vector(sizes.states), 0.0
    for j in range(n):
        g[j] = -step.H[0, j]
        for i in range(n):
            g[j] += step.H[0, i] * step.F[i, j]
    for i in range(n):
        for j in range(n):
            s += g[i] * P[i, j] * g[j] + step.H[0, i] * step.Q[i, j] * step.H[0, j]
    return math.sqrt(max(s, 0.0))


@compiled_part
def innovation(sizes: Sizes, H: Floats, reading: float, x: Floats) -> float:
    """Equation (3)."""
    for i in range(len(sizes.states)):
        reading -= H[0, i] * x[i]
    return reading


@compiled_part
def round_up(variance: float) -> float:
    """Return the next power of four, which a last digit seldom changes."""
    if not variance > 0.0:
        return 0.0
    return math.ldexp(1.0, 2 * math.ceil(0.5 * math.log2(min(max(variance, 1e-290), 1e200))))


@compiled_part
def jump(sizes: Sizes, step: Step, nu: float, rule: Rule, state: State, variances: Floats, counters: Floats) -> None:  # noqa: PLR0913
    """Add to a predicted covariance what makes an innovation likely: to the level alone, or to all states alike.

    All states get no more than leaves the readings that follow some digits; where that is too little, as after a start
    from wild readings, another jump comes as soon as those have told the states.
    """
    n, told, square = len(sizes.states), 0.0, min(nu * nu, WIDE * step.R[0, 0])
    level = rule.level if counters[SINCE] >= rule.at_most else -1
    for i in range(n):
        for j in range(n):
            told += step.H[0, i] * state.P[i, j] * step.H[0, j]
    for i in range(n):
        if level >= 0:
            variances[i] = round_up(nu * nu / (step.H[0, i] * step.H[0, i])) if i == level else 0.0
        else:
            variances[i] = round_up(square * (state.P[i, i] / told)) if told > 0.0 else 0.0
        state.P[i, i] += variances[i]
    counters[SINCE] = -1.0 if level >= 0 else -float(n)
    counters[JUMPED] = 1.0


@compiled_part
def agrees(rule: Rule, R: float, nu: float, counters: Floats) -> bool:
    """Whether an innovation differs from the last one rejected by noise and by what a signal may have moved."""
    noise = math.sqrt(2.0 * R + counters[WANDERED] * counters[WANDERED])
    return bool(counters[AGREEING] > 0.0 and abs(nu - counters[LAST]) <= rule.threshold * noise)


@compiled_part
def believe(sizes: Sizes, step: Step, z: Floats, row: int, state: State, counters: Floats) -> None:  # noqa: PLR0913
    """Take a reading into the predicted state, equations (4) to (7)."""
    weigh(sizes, step.H, step.R, state)
    correct(sizes, step.H, z, row, state)
    joseph(sizes, step.H, step.R, state)
    counters[REJECTED] = counters[AGREEING] = 0.0
    counters[SINCE] += 1.0


@compiled_part
def reject(rule: Rule, R: float, nu: float, counters: Floats) -> bool:
    """Count a reading that is rejected; tell whether it is to be believed after all.

    So many in a row are motion, and so is one soon after a jump: what moved goes on.
    """
    counters[AGREEING] = counters[AGREEING] + 1.0 if agrees(rule, R, nu, counters) else 1.0
    counters[REJECTED] += 1.0
    counters[LAST] = nu
    counters[WANDERED] = 0.0
    goes_on = counters[JUMPED] > 0.0 and counters[SINCE] < GOES_ON
    return bool(goes_on or counters[AGREEING] >= rule.agree or counters[REJECTED] >= rule.at_most)


@compiled_part
def carry(sizes: Sizes, state: State, counters: Floats, memory: Floats, saving: float) -> None:
    """Save x, P and the counters in a memory, or load them."""
    at = transfer_vector(sizes.states, state.x, memory, 0, saving)
    at = transfer_matrix(sizes.states, sizes.states, state.P, memory, at, saving)
    transfer_vector(COUNTERS, counters, memory, at, saving)


@compiled
def find_outliers(  # noqa: PLR0913  (a door for Python: what is read, what moves, what is written)
    sizes: Sizes, system: System, record: Record, begun: int, rule: Rule, memory: Floats, verdicts: Codes,
    jumps: Floats,
) -> int:  # fmt: skip
    """Judge the rows of a record of one channel from `begun` on.

    `memory` holds x, P and the counters before them, and those after them when done. `verdicts` gets
    USED, SPIKE or STEP where a reading arrived, `jumps` for each STEP the variances that are added to the
    states before it. Returns how many jumps there are.
    """
    state, counters = new_state(sizes), stack_vector(COUNTERS)
    carry(sizes, state, counters, memory, LOAD)
    z, run, found = record.z, 0, 0
    for row in range(begun, len(z)):
        run = run_of(record, row, run)
        step = step_of(sizes, system, max(record.step[run], 0))
        if record.step[run] >= 0:
            if counters[AGREEING] > 0.0:
                counters[WANDERED] += wander(sizes, step, state.P)
            predict(sizes, step.F, step.Q, state)
        if not look(sizes, z, row, state):
            continue
        weigh(sizes, step.H, step.R, state)
        nu = innovation(sizes, step.H, z[row, 0], state.x)
        if counters[SINCE] < 0.0 or not abs(nu) > rule.threshold * math.sqrt(state.D[0]):
            believe(sizes, step, z, row, state, counters)
            verdicts[row] = USED
            continue
        verdicts[row] = SPIKE
        if reject(rule, step.R[0, 0], nu, counters):
            jump(sizes, step, nu, rule, state, jumps[found], counters)
            believe(sizes, step, z, row, state, counters)
            verdicts[row], found = STEP, found + 1
    carry(sizes, state, counters, memory, SAVE)
    return found
