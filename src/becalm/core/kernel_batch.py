"""Many complete records of one model in Numba: gains computed once, each record a table's reader.

Gains do not depend on the readings. So they are rehearsed once, until they have settled, and noted
with what looking ahead four rows needs of them; then each record runs through that table in blocks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import BLOCK, Floats
from becalm.core.compiling import compiled, compiled_part
from becalm.core.kernel_ahead import AHEAD, FOUR, Rows, add_up, combine, copy, looks_ahead
from becalm.core.kernel_block import TOTAL, Block, new_block, run_of, step_of
from becalm.core.kernel_matrices import multiply
from becalm.core.kernel_settling import LOAD, SAVE, SETTLED, new_watch, notice, transfer
from becalm.core.kernel_steps import State, joseph, new_state, predict, shrink, weigh
from becalm.core.kernels import innovation_spread, spread
from becalm.core.sized import Size, Sizes, down, piece, stack_matrix, stack_rows
from becalm.core.system import Record, System


class Table(NamedTuple):
    """What every complete record has in common, row by row; T rows until the gain has settled."""

    A: Floats  # (n, n, T) closed loop, (I - K H) F; for a row without a step, I - K H
    K: Floats  # (n, m, T)
    C: Floats  # (m, n, T) what a row is predicted by, H F or H
    W: Floats  # (m, m, T) whitens innovations: W' W = S^-1
    A4: Floats  # (n, n, T) from four rows before
    K4: Floats  # (n, 4, T) weights of the last four readings of one channel
    sigma: Floats  # (m, T)
    innovation_sigma: Floats  # (m, T)
    log_det: Floats  # (T,)
    live: Floats  # (T,) dimension of S


class Results(NamedTuple):
    """Where results of B records go; an array of no columns is not wanted."""

    signal: Floats  # (B, m, N)
    innovation: Floats  # (B, m, N)
    mean: Floats  # (B, n, N)
    squares: Floats  # (B,) sums of nu' S^-1 nu


@compiled
def rehearse(  # noqa: PLR0913  (a door for Python)
    sizes: Sizes, system: System, record: Record, begun: int, memory: Floats, table: Table
) -> int:
    """Run the covariances from row `begun` on, as if every reading arrived; return the row after which they settled.

    `memory` (1, M) holds the state before, and the settled one when done.
    """
    state, watch = new_state(sizes), new_watch(sizes)
    transfer(sizes, state, watch, memory[0], LOAD)
    run, row = 0, begun
    for c in range(len(sizes.channels)):
        state.seen[c] = 1.0
    while row < len(record.z) and watch.counters[SETTLED] == 0.0:
        run = run_of(record, row, run)
        step = record.step[run]
        one = step_of(sizes, system, step)
        if step >= 0:
            predict(sizes, one.F, one.Q, state)
        weigh(sizes, one.H, one.R, state)
        note(sizes, system, step, row, state, table)
        note_scale(sizes, row, state, table)
        if reads_ahead(sizes) and row >= begun + AHEAD:
            note_ahead(sizes, row, table)
        joseph(sizes, one.H, one.R, state)
        for c in range(len(sizes.channels)):
            table.sigma[c, row] = spread(sizes, one.H, state.P, c)
        notice(sizes, one, step, state, watch, 1.0)
        row += 1
    transfer(sizes, state, watch, memory[0], SAVE)
    return row


@compiled_part
def reads_ahead(sizes: Sizes) -> bool:
    """Whether a table of what looking ahead needs is noted; of one channel."""
    return len(sizes.channels) == 1 and looks_ahead(sizes.states, sizes.channels)


@compiled_part
def note(sizes: Sizes, system: System, step: int, row: int, state: State, table: Table) -> None:  # noqa: PLR0913
    """Note what a row does to every record."""
    n, m = len(sizes.states), len(sizes.channels)
    A, moved = stack_matrix(sizes.states, sizes.states), stack_matrix(sizes.states, sizes.states)
    one = step_of(sizes, system, step)
    F, H = one.F, one.H
    shrink(sizes, H, state.K, A)
    multiply(sizes.states, sizes.states, A, F, moved)
    for i in range(n):
        for c in range(m):
            table.K[i, c, row] = state.K[i, c]
            s = 0.0
            for j in range(n):
                s += H[c, j] * F[j, i]
            table.C[c, i, row] = s if step >= 0 else H[c, i]
        for j in range(n):
            table.A[i, j, row] = moved[i, j] if step >= 0 else A[i, j]


@compiled_part
def note_scale(sizes: Sizes, row: int, state: State, table: Table) -> None:
    """Note how large innovations are, and how they are whitened: W = D^-1/2 L^-1."""
    L, D, W = state.L, state.D, stack_matrix(sizes.channels, sizes.channels)
    table.log_det[row] = table.live[row] = 0.0
    for a in range(len(sizes.channels)):
        weight = 1.0 / np.sqrt(D[a]) if D[a] > 0.0 else 0.0
        for b in range(len(sizes.channels)):
            s = 1.0 if a == b else 0.0
            for c in range(a):
                s -= L[a, c] * W[c, b]
            W[a, b] = s
            table.W[a, b, row] = weight * s
        table.innovation_sigma[a, row] = innovation_spread(state, a)
        if D[a] > 0.0:
            table.log_det[row] += np.log(D[a])
            table.live[row] += 1.0


@compiled_part
def note_ahead(sizes: Sizes, row: int, table: Table) -> None:
    """Note how a row follows from the state four rows before and the readings since."""
    n = len(sizes.states)
    M, A, moved = (
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
    )
    for i in range(n):
        for j in range(n):
            M[i, j] = 1.0 if i == j else 0.0
    for lag in range(len(FOUR)):
        for i in range(n):
            s = 0.0
            for j in range(n):
                s += M[i, j] * table.K[j, 0, row - lag]
                A[i, j] = table.A[i, j, row - lag]
            table.K4[i, len(FOUR) - 1 - lag, row] = s
        multiply(sizes.states, sizes.states, M, A, moved)
        for i in range(n):
            for j in range(n):
                M[i, j] = moved[i, j]
    for i in range(n):
        for j in range(n):
            table.A4[i, j, row] = M[i, j]


@compiled
def run_together(  # noqa: PLR0913  (a door for Python)
    sizes: Sizes,
    weights: Size,
    H: Floats,
    z: Floats,
    begun: int,
    stop: int,
    table: Table,
    x: Floats,
    results: Results,
) -> None:
    """Filter rows `begun` to `stop` of a group of complete records, small enough that a block's table stays near.

    z (B, N, m) are their readings and x (n, B) their states, changed in place; `weights` is n (n + 4) + m n + m m.
    """
    block, near, told = new_block(sizes), stack_rows(weights, BLOCK), stack_rows(TOTAL, BLOCK)[0]
    for first in range(begun, stop, BLOCK):
        count = min(BLOCK, stop - first)
        ahead = reads_ahead(sizes) and first > begun and count == BLOCK
        fetch(sizes, table, first, near)
        for b in range(len(z)):
            for c in range(len(sizes.channels)):
                read(z[b], first, c, sizes.channels, count, block.z[c])
            for i in range(len(sizes.states)):
                block.x[i][0] = x[i, b]
            read_table(sizes, table, first, AHEAD - 1 if ahead else count, block)
            if ahead:
                look_ahead_by_table(sizes, near, block)
            for i in range(len(sizes.states)):
                x[i, b] = block.x[i][count]
            results.squares[b] += innovate_by_table(sizes, near, count, block)
            write_record(sizes, H, b, first, count, block, told, results)


@compiled_part
def read(z: Floats, first: int, channel: int, channels: Size, count: int, own: Floats) -> None:  # noqa: PLR0913
    """Copy some readings of one channel."""
    if count == BLOCK:
        readings = down(z, first, channel, channels, BLOCK)
        for k in range(BLOCK):
            own[k] = readings[k]
    else:
        for k in range(count):
            own[k] = z[first + k, channel]


@compiled_part
def store(own: Floats, shift: int, target: Floats, first: int, count: int) -> None:
    """Copy some results of a block, from `shift` on."""
    if count == BLOCK:
        copy(own, shift, piece(target, first, BLOCK))
    else:
        for k in range(count):
            target[first + k] = own[k + shift]


@compiled_part
def read_table(sizes: Sizes, table: Table, first: int, count: int, block: Block) -> None:
    """Run x = A x + K z through some rows of the table, one by one."""
    n, m, x = len(sizes.states), len(sizes.channels), block.x
    for k in range(count):
        for i in range(n):
            s = 0.0
            for j in range(n):
                s += table.A[i, j, first + k] * x[j][k]
            for c in range(m):
                s += table.K[i, c, first + k] * block.z[c][k]
            x[i][k + 1] = s


@compiled_part
def fetch(sizes: Sizes, table: Table, first: int, near: Rows) -> None:
    """Copy a block of the table to the stack, where the compiler knows that nothing else writes.

    Row by row of A4 and K4 side by side, then the rows of C, then those of W.
    """
    n, m, width = len(sizes.states), len(sizes.channels), len(sizes.states) + len(FOUR)
    for i in range(n):
        for lag in range(len(FOUR)):
            copy(piece(table.K4[i, lag], first + AHEAD - 1, BLOCK), 0, near[i * width + lag])
        for j in range(n):
            copy(piece(table.A4[i, j], first + AHEAD - 1, BLOCK), 0, near[i * width + len(FOUR) + j])
    for c in range(m):
        for i in range(n):
            copy(piece(table.C[c, i], first, BLOCK), 0, near[n * width + c * n + i])
        for a in range(m):
            copy(piece(table.W[c, a], first, BLOCK), 0, near[n * width + m * n + c * m + a])


@compiled_part
def look_ahead_by_table(sizes: Sizes, near: Rows, block: Block) -> None:
    """Run x[k + 4] = A4 x[k] + K4 z[k .. k + 3]."""
    n, x, z, width = len(sizes.states), block.x, block.z[0], len(sizes.states) + len(FOUR)
    for k in range(BLOCK - AHEAD + 1):
        for i in range(n):
            s = 0.0
            for lag in range(len(FOUR)):
                s += near[i * width + lag][k] * z[k + lag]
            for j in range(n):
                s += near[i * width + len(FOUR) + j][k] * x[j][k]
            x[i][k + 4] = s


@compiled_part
def innovate_by_table(sizes: Sizes, near: Rows, count: int, block: Block) -> float:
    """Write the innovations of some rows, and return the sum of nu' S^-1 nu; uses up block.z."""
    n, m, terms, total = len(sizes.states), len(sizes.channels), block.sums[0], 0.0
    C = n * (n + len(FOUR))
    W = C + m * n
    for c in range(m):
        for k in range(BLOCK):
            s = block.z[c][k]
            for i in range(n):
                s -= near[C + c * n + i][k] * block.x[i][k]
            block.nu[c][k] = s
    for c in range(m):
        for k in range(BLOCK):
            s = 0.0
            for a in range(c + 1):
                s += near[W + c * m + a][k] * block.nu[a][k]
            terms[k] = s * s
        for k in range(count, BLOCK):
            terms[k] = 0.0
        total += add_up(terms)
    return total


@compiled_part
def write_record(  # noqa: PLR0913
    sizes: Sizes, H: Floats, b: int, first: int, count: int, block: Block, told: Floats, results: Results
) -> None:
    """Write some rows of one record."""
    for c in range(len(sizes.channels)):
        if results.signal.shape[2]:
            combine(sizes.states, H[c], block.x, 1, told)
            store(told, 0, results.signal[b, c], first, count)
        if results.innovation.shape[2]:
            store(block.nu[c], 0, results.innovation[b, c], first, count)
    if results.mean.shape[2]:
        for i in range(len(sizes.states)):
            store(block.x[i], 1, results.mean[b, i], first, count)
