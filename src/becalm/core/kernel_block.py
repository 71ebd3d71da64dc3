"""A block of rows with a settled gain: readings in, states and innovations out, all on the stack."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import BLOCK, Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_ahead import AFTER, Loop, Rows, add_up, copy, prepare, run_block
from becalm.core.kernel_matrices import copy_matrix
from becalm.core.kernel_settling import LAST_STEP, SETTLED, Watch
from becalm.core.kernel_steps import State, close, see_through
from becalm.core.sized import Size, Sizes, across, down, layer, size, stack_rows
from becalm.core.system import Record, Step, System

TAME = 1e190  # sum of squares; NaN, Inf and what no sensor reads are beyond it, as are states that run away
TOTAL: Size = size(1)


class Block(NamedTuple):
    """What a block works on: BLOCK rows, one more for the states before it."""

    z: Rows  # m of (BLOCK,)
    p: Rows  # m of (BLOCK,) predictions of the readings, H F x
    nu: Rows  # m of (BLOCK,) innovations
    x: Rows  # n of (BLOCK + 1,)
    sums: Rows  # 1 of (BLOCK,)


@woven
def new_block(sizes: Sizes) -> Block:
    """Make room for a block on the stack."""
    n, m = sizes
    return Block(
        stack_rows(m, BLOCK),
        stack_rows(m, BLOCK),
        stack_rows(m, BLOCK),
        stack_rows(n, AFTER),
        stack_rows(TOTAL, BLOCK),
    )


@compiled_part
def step_of(sizes: Sizes, system: System, number: int) -> Step:
    """Return one step of a system; the number of no step, -1, names the first."""
    n, m = sizes.states, sizes.channels
    number = max(number, 0)
    return Step(
        layer(system.F, number, n, n), layer(system.Q, number, n, n), layer(system.H, 0, m, n), layer(system.R, 0, m, m)
    )


@compiled_part
def close_loop(sizes: Sizes, system: System, step: int, state: State, loop: Loop, HF: Floats) -> None:  # noqa: PLR0913
    """Prepare x = (I - K H) F x + K z, and write H F."""
    one = step_of(sizes, system, step)
    close(sizes, one.H, one.F, state.K, loop.A)
    copy_matrix(sizes.states, sizes.channels, state.K, loop.G)
    see_through(sizes, one.H, one.F, HF)
    prepare(sizes.states, sizes.channels, loop)


@compiled_part
def read_block(sizes: Sizes, z: Floats, row: int, block: Block) -> None:
    """Copy the readings of a block, a row of their own for each channel."""
    for c in range(len(sizes.channels)):
        readings, own = down(z, row, c, sizes.channels, BLOCK), block.z[c]
        for k in range(BLOCK):
            own[k] = readings[k]


@compiled_part
def fetch_block(sizes: Sizes, z: Floats, prediction: Floats, row: int, block: Block) -> bool:
    """Copy the readings (N, m) of a block, and their predictions (m, N); False where one is missing or runs away."""
    read_block(sizes, z, row, block)
    total, terms = 0.0, block.sums[0]
    for c in range(len(sizes.channels)):
        p, nu = block.p[c], block.nu[c]
        copy(across(prediction, c, row, BLOCK), 0, p)
        for k in range(BLOCK):
            nu[k] = block.z[c][k] - p[k]
            terms[k] = nu[k] * nu[k]
        total += add_up(terms)
    return bool(total <= TAME)


@compiled_part
def settled_block(  # noqa: PLR0913
    sizes: Sizes, z: Floats, row: int, state: State, loop: Loop, HF: Floats, block: Block
) -> float:
    """Run a block with the settled gain, (1), (3), (6); return the sum of nu' S^-1 nu (8), and use up block.z.

    -1, and the state unchanged, where a reading is missing or a state runs away.
    """
    n, x = len(sizes.states), block.x
    read_block(sizes, z, row, block)
    for i in range(n):
        x[i][0] = state.x[i]
    run_block(sizes.states, sizes.channels, loop, block.z, x)
    innovate(sizes, HF, block)
    squares, total = whiten_block(sizes, state.L, state.D, block)
    for i in range(n):
        total += x[i][BLOCK] * x[i][BLOCK]
    if not total <= TAME:
        return -1.0
    for i in range(n):
        state.x[i] = x[i][BLOCK]
    for c in range(len(sizes.channels)):
        state.nu[c], state.seen[c] = block.nu[c][BLOCK - 1], 1.0
    return squares


@compiled_part
def innovate(sizes: Sizes, HF: Floats, block: Block) -> None:
    """Write the predictions and the innovations of a block, (3)."""
    for c in range(len(sizes.channels)):
        z, p, nu = block.z[c], block.p[c], block.nu[c]
        for k in range(BLOCK):
            s = 0.0
            for i in range(len(sizes.states)):
                s += HF[c, i] * block.x[i][k]
            p[k] = s
            nu[k] = z[k] - s


@compiled_part
def whiten_block(sizes: Sizes, L: Floats, D: Floats, block: Block) -> tuple[float, float]:
    """Return the sum of nu' S^-1 nu over a block, (8), and that of the whitened squares; uses up block.z."""
    e, terms = block.z, block.sums[0]
    squares, total = 0.0, 0.0
    for a in range(len(sizes.channels)):
        for k in range(BLOCK):
            s = block.nu[a][k]
            for c in range(a):
                s -= L[a, c] * e[c][k]
            e[a][k] = s
            terms[k] = s * s
        s = add_up(terms)
        total += s
        if D[a] > 0.0:
            squares += s / D[a]
    return squares, total


@compiled_part
def run_of(record: Record, row: int, near: int) -> int:
    """Return the run of a row, looked for from a near one on."""
    while record.first[near + 1] <= row:
        near += 1
    while record.first[near] > row:
        near -= 1
    return near


@compiled_part
def is_settled(watch: Watch, record: Record, run: int, row: int, enough: float) -> bool:
    """Whether a whole block from `row` on follows the step whose gain has settled."""
    counters = watch.counters
    same = record.step[run] == counters[LAST_STEP] and row + BLOCK <= record.first[run + 1]
    return bool(same and counters[SETTLED] >= enough)


@compiled_part
def log_det_of(sizes: Sizes, D: Floats) -> tuple[float, int]:
    """Return log det S and its dimension from the pivots; dead ones are left out."""
    log_det, live = 0.0, 0
    for a in range(len(sizes.channels)):
        if D[a] > 0.0:
            log_det += np.log(D[a])
            live += 1
    return log_det, live
