"""Many readings in Numba, backward: the twin of `reference.smooth`.

The forward pass leaves its predictions, which are all that a gain that is known needs to smooth, and a
memory of its state before each block. Where more is needed, a block is filtered again from there, on the
stack; so no covariance of a whole record is ever kept.
"""

from __future__ import annotations

from becalm.core.arrays import BLOCK, Floats
from becalm.core.compiling import compiled, compiled_part
from becalm.core.kernel_ahead import new_loop
from becalm.core.kernel_block import close_loop, fetch_block, is_settled, new_block, run_of, step_of
from becalm.core.kernel_gap import has_lost_digits, regress
from becalm.core.kernel_matrices import copy_matrix
from becalm.core.kernel_moving import move_gains, new_moving
from becalm.core.kernel_return import (
    LATER,
    Future,
    inform,
    new_return,
    prepare_return,
    pull_back_spread,
    return_through,
    smooth_cov,
    write_smoothed_block,
    write_smoothed_means,
    write_spread_block,
)
from becalm.core.kernel_return_one import return_moving
from becalm.core.kernel_row import advance
from becalm.core.kernel_settling import (
    FIRST_CHECK,
    LOAD,
    NEXT_CHECK,
    SAVE,
    SETTLED,
    STEADY,
    Watch,
    new_watch,
    transfer,
)
from becalm.core.kernel_steps import State, new_state, shrink
from becalm.core.kernels import Trace, can_move, write_belief
from becalm.core.sized import Sizes, stack_matrix, stack_vector
from becalm.core.system import Record, System


@compiled_part
def pull_back(sizes: Sizes, A: Floats, r: Floats) -> None:
    """Carry r back through a linear map: A' r."""
    n, u = len(sizes.states), stack_vector(sizes.states)
    for i in range(n):
        s = 0.0
        for k in range(n):
            s += A[k, i] * r[k]
        u[i] = s
    for i in range(n):
        r[i] = u[i]


@compiled_part
def step_back(sizes: Sizes, F: Floats, H: Floats, state: State, future: Future) -> None:
    """Equations (11) and (12); `state` holds the gain, the factors of S and the innovation of the row."""
    n, m = len(sizes.states), len(sizes.channels)
    A, C, G = (
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.channels),
    )
    shrink(sizes, H, state.K, A)
    inform(sizes, H, state, G)
    pull_back(sizes, A, future.r)
    for i in range(n):
        for a in range(m):
            future.r[i] += G[i, a] * state.nu[a]
        for j in range(n):
            C[i, j] = 0.0
            for a in range(m):
                C[i, j] += G[i, a] * H[a, j]
    pull_back_spread(sizes, A, C, future.N)
    for i in range(n):
        for j in range(n):
            C[i, j] = 0.0
    pull_back(sizes, F, future.r)
    pull_back_spread(sizes, F, C, future.N)


@compiled_part
def smooth_state(sizes: Sizes, state: State, future: Future) -> None:
    """Equation (9); `state` holds the filtered belief, and its x becomes the smoothed one."""
    n = len(sizes.states)
    for i in range(n):
        for j in range(n):
            state.x[i] += state.P[i, j] * future.r[j]


@compiled_part
def smooth_spread(sizes: Sizes, system: System, step: int, state: State, future: Future) -> None:
    """Equation (10), from the row after where that keeps more digits; the filtered P becomes the smoothed one.

    `step` is the one before this row.
    """
    n, smoothed = sizes.states, stack_matrix(sizes.states, sizes.states)
    smooth_cov(sizes, state.P, future.N, smoothed)
    if future.counters[LATER] and has_lost_digits(n, state.P, smoothed):
        regress(sizes, future.F, future.Q, state.P, future.P, smoothed)
    copy_matrix(n, n, smoothed, state.P)
    copy_matrix(n, n, smoothed, future.P)
    before = step_of(sizes, system, step)
    copy_matrix(n, n, before.F, future.F)
    copy_matrix(n, n, before.Q, future.Q)
    future.counters[LATER] = 1.0 if step >= 0 else 0.0


@compiled_part
def can_return_moving(  # noqa: PLR0913
    sizes: Sizes, record: Record, run: int, row: int, watch: Watch, trace: Trace
) -> bool:
    """Whether a whole block of one channel follows one step, and no states of its rows are wanted."""
    return bool(trace.mean.shape[1] == 0 and can_move(sizes, record, run, row, watch, trace))


@compiled_part
def unsettle(future: Future) -> None:
    """Note that N has not settled; a check must not find what another stretch has left."""
    future.counters[SETTLED], future.counters[STEADY], future.counters[NEXT_CHECK] = 0.0, 0.0, FIRST_CHECK
    future.then[0, 0] = -1.0


@compiled_part
def return_row(  # noqa: PLR0913
    sizes: Sizes, system: System, step: int, row: int, memory: Floats, state: State, watch: Watch, future: Future,
    trace: Trace,
) -> None:  # fmt: skip
    """Smooth and write one row, whose own memory is given."""
    transfer(sizes, state, watch, memory, LOAD)
    smooth_state(sizes, state, future)
    if trace.sigma.shape[1]:
        smooth_spread(sizes, system, step, state, future)
    one = step_of(sizes, system, step)
    write_belief(sizes, trace, row, one.H, state)
    if step >= 0:
        transfer(sizes, state, watch, memory, LOAD)
        step_back(sizes, one.F, one.H, state, future)


@compiled
def backward(  # noqa: PLR0913  (a door for Python: what is read, what moves, what is written)
    sizes: Sizes, system: System, record: Record, begun: int, enough: float, memory: Floats, rows: Floats,
    future: Future, trace: Trace,
) -> None:  # fmt: skip
    """Smooth the rows of a record from the last to `begun`, after `forward` has filled `memory`.

    So has it `trace.prediction`, which may be the place of the signal. `rows` is room for the memory of
    each row of a block. Afterwards `future` holds what the rows from
    `begun` on say of the filtered state before them.
    """
    state, watch, block, back = new_state(sizes), new_watch(sizes), new_block(sizes), new_return(sizes)
    loop, HF, ready = new_loop(sizes.states, sizes.channels), stack_matrix(sizes.channels, sizes.states), False
    stop, run, moving = len(record.z), len(record.step) - 1, new_moving(sizes)
    while stop > begun:
        start = max((stop - 1) // BLOCK * BLOCK, begun)
        transfer(sizes, state, watch, memory[1 + start // BLOCK], LOAD)
        run = run_of(record, start, run)
        whole = start + BLOCK == stop and fetch_block(sizes, record.z, trace.prediction, start, block)
        if whole and is_settled(watch, record, run, start, enough):
            if not ready:
                close_loop(sizes, system, record.step[run], state, loop, HF)
                prepare_return(sizes, step_of(sizes, system, 0).H, HF, state, loop, back)
                ready = True
            return_through(sizes, block, back, future)
            write_smoothed_block(sizes, trace, start, block, back)
            if trace.mean.shape[1]:
                write_smoothed_means(sizes, trace, start, state, loop, block, back)
            if trace.sigma.shape[1]:
                write_spread_block(sizes, trace, start, step_of(sizes, system, 0).H, state.P, loop.A, back.C, future)
            future.counters[LATER] = 0.0
            stop = start
            continue
        ready = False
        if whole and can_return_moving(sizes, record, run, start, watch, trace):
            step = step_of(sizes, system, record.step[run])
            if move_gains(sizes, step, record.step[run], state.P, moving):
                return_moving(sizes, step, block, moving, back.r, future, trace, start)
                unsettle(future)
                future.counters[LATER] = 0.0
                stop = start
                continue
        for row in range(start, stop):
            run = run_of(record, row, run)
            step = record.step[run]
            advance(sizes, step_of(sizes, system, step), step, record.z, row, state, watch, enough)
            transfer(sizes, state, watch, rows[row - start], SAVE)
        unsettle(future)
        for row in range(stop - 1, start - 1, -1):
            run = run_of(record, row, run)
            return_row(sizes, system, record.step[run], row, rows[row - start], state, watch, future, trace)
        stop = start
