"""The second pass over a stream's block: the filter of one channel, row by row, as far as its state is known."""

from __future__ import annotations

import math
from typing import NamedTuple

from becalm.core.arrays import Floats, Integers
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_gate import COUNTERS, SPIKE, STEP, USED, Rule
from becalm.core.kernel_matrices import copy_matrix
from becalm.core.kernel_one import Reach, new_reach
from becalm.core.kernel_online import new_step
from becalm.core.kernel_row import advance
from becalm.core.kernel_settling import (
    LAST_STEP,
    LOAD,
    NO_STEP,
    SAVE,
    SETTLED,
    Watch,
    new_watch,
    transfer,
    transfer_vector,
)
from becalm.core.kernel_steps import LARGEST_READING, State, Step, new_state
from becalm.core.kernel_stream_gate import gate_reading
from becalm.core.kernel_stream_layout import (
    AGREE,
    AT_MOST,
    DETERMINED,
    ENOUGH,
    FILTER,
    GATE,
    GATED,
    KNOWN,
    LEVEL,
    LEVEL_STATE,
    THRESHOLD,
    UNKNOWN,
    Channels,
    Out,
    Rows,
    Work,
)
from becalm.core.kernels import spread
from becalm.core.sized import Size, Sizes, layer, size, stack_matrix, stack_vector

THREE: Size = size(3)


class Desk(NamedTuple):
    """Room for one channel's filter, on the stack."""

    state: State
    watch: Watch
    step: Step
    C: Floats  # (1, n)
    z: Floats  # (1, 1)
    ahead: State
    reach: Reach
    variances: Floats  # (n,)
    counters: Floats  # (7,) of the gate
    held: Floats  # (3,) sigma of signal and of innovation, and the step that `step` holds; -1 for none


@woven
def new_desk(sizes: Sizes) -> Desk:
    """Make room on the stack."""
    n, m = sizes
    return Desk(
        new_state(sizes), new_watch(sizes), new_step(sizes), stack_matrix(m, n), stack_matrix(m, m), new_state(sizes),
        new_reach(sizes), stack_vector(n), stack_vector(COUNTERS), stack_vector(THREE),
    )  # fmt: skip


@compiled_part
def fetch_step(sizes: Sizes, channels: Channels, at: int, desk: Desk) -> None:
    """Copy the matrices of a step to the desk."""
    n = sizes.states
    copy_matrix(n, n, layer(channels.F, at, n, n), desk.step.F)
    copy_matrix(n, n, layer(channels.Q, at, n, n), desk.step.Q)
    desk.held[2] = at


@compiled_part
def sit_down(sizes: Sizes, channels: Channels, c: int, numbers: Floats, desk: Desk) -> None:
    """Bring a channel's filter to the desk."""
    n, m = sizes
    transfer(sizes, desk.state, desk.watch, numbers[FILTER:], LOAD)
    transfer_vector(COUNTERS, desk.counters, numbers, GATE, LOAD)
    copy_matrix(m, n, layer(channels.H, c, m, n), desk.step.H)
    copy_matrix(m, n, layer(channels.C, c, m, n), desk.C)
    copy_matrix(m, m, layer(channels.R, c, m, m), desk.step.R)
    desk.held[2] = -1.0
    hold(sizes, desk)


@compiled_part
def hold(sizes: Sizes, desk: Desk) -> None:
    """Keep what a settled gain does not change."""
    desk.held[0] = spread(sizes, desk.C, desk.state.P, 0)
    desk.held[1] = math.sqrt(desk.state.D[0]) if desk.state.D[0] > 0.0 else 0.0


@compiled_part
def judge_row(sizes: Sizes, rule: Rule, number: float, desk: Desk) -> int:
    """Ask the gate about the reading on the desk: take it away where it is a spike, widen Q where the signal jumped."""
    became = gate_reading(
        sizes, desk.step, desk.reach, rule, desk.z[0, 0], desk.state, desk.ahead, desk.variances, desk.counters
    )
    if became == SPIKE:
        desk.z[0, 0] = math.nan
    if became == STEP:
        desk.watch.counters[LAST_STEP] = NO_STEP
        for i in range(len(sizes.states)):
            desk.step.Q[i, i] += desk.variances[i]
    return became


@compiled_part
def take_reading(sizes: Sizes, gated: bool, rule: Rule, number: float, enough: float, desk: Desk) -> int:  # noqa: PLR0913
    """Take the reading on the desk, a step of length `number` after the row before; tell what the gate said."""
    became = judge_row(sizes, rule, number, desk) if gated else USED
    counters = desk.watch.counters
    whole = abs(desk.z[0, 0]) <= LARGEST_READING
    alike = whole and counters[SETTLED] >= enough and counters[LAST_STEP] == number
    advance(sizes, desk.step, number, desk.z, 0, desk.state, desk.watch, enough)
    if not alike:
        hold(sizes, desk)
    if became == STEP:
        counters[LAST_STEP], desk.held[2] = NO_STEP, -1.0  # its Q is no other row's
    return became


@compiled_part
def run_filter(  # noqa: PLR0913
    sizes: Sizes, channels: Channels, c: int, rows: Rows, work: Work, numbers: Floats, marks: Integers, out: Out,
    begun: int, desk: Desk,
) -> int:  # fmt: skip
    """Filter the rows of a channel from `begun` on; return the row where its state is not known, or how many there are.

    Rows before the first reading of all are told as unknown.
    """
    fixed, column, usable, count = channels.fixed[c], channels.columns[c], work.usable[c], len(rows.elapsed)
    normalised, anew, row = work.normalised[c], work.anew[c], begun
    while row < count and marks[KNOWN] == UNKNOWN and math.isnan(usable[row]):
        out.signal[row, column], out.sigma[row, column], normalised[row] = math.nan, math.inf, math.nan
        row += 1
    if row == count or marks[KNOWN] != DETERMINED:
        return row
    rule = Rule(fixed[THRESHOLD], int(fixed[AGREE]), int(fixed[AT_MOST]), int(fixed[LEVEL_STATE]), False)
    sit_down(sizes, channels, c, numbers, desk)
    while row < count and not anew[row]:
        at = c * len(rows.lengths) + rows.step[row]
        if desk.held[2] != at:
            fetch_step(sizes, channels, at, desk)
        desk.z[0, 0] = usable[row] - numbers[LEVEL]
        became = take_reading(sizes, fixed[GATED] > 0.0, rule, rows.lengths[rows.step[row]], fixed[ENOUGH], desk)
        y = 0.0
        for i in range(len(sizes.states)):
            y += desk.C[0, i] * desk.state.x[i]
        out.signal[row, column], out.sigma[row, column] = y + numbers[LEVEL], desk.held[0]
        out.verdicts[row, column] = became if became else out.verdicts[row, column]
        normalised[row] = desk.state.nu[0] / desk.held[1] if desk.state.seen[0] > 0.0 else math.nan
        row += 1
    transfer(sizes, desk.state, desk.watch, numbers[FILTER:], SAVE)
    transfer_vector(COUNTERS, desk.counters, numbers, GATE, SAVE)
    return row
