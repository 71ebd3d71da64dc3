"""A block of one channel's readings while its gain still moves: covariances first, then the states."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import BLOCK, Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_ahead import Rows, add_up, combine, looks_ahead
from becalm.core.kernel_block import TAME, Block, innovate, read_block
from becalm.core.kernel_jump import Jumps, get_row, keeps_digits, leap_through, new_jumps, prepare_jumps, set_row
from becalm.core.kernel_matrices import copy_matrix
from becalm.core.kernel_one import subtract
from becalm.core.kernel_steps import State, joseph, move, see_through
from becalm.core.sized import Sizes, stack_matrix, stack_rows, stack_triangle, stack_vector
from becalm.core.system import Step

_PRODUCTS = 16  # of a block's numbers, whose logarithms are taken
_LEAST = 1e-280


class Moving(NamedTuple):
    """What changes from row to row of a block while its gain still moves."""

    M: Rows  # n (n + 1) / 2 of (BLOCK,) predicted covariance, a lower triangle row by row
    S: Floats  # (BLOCK,) innovation variance
    K: Rows  # n of (BLOCK,)
    jumps: Jumps


@woven
def new_moving(sizes: Sizes) -> Moving:
    """Make room for it on the stack."""
    n, m = sizes
    return Moving(stack_triangle(n, BLOCK), stack_rows(m, BLOCK)[0], stack_rows(n, BLOCK), new_jumps(n))


@compiled_part
def moves_in_blocks(sizes: Sizes) -> bool:
    """Whether a model has one channel, and so few states that eight covariances fit into registers and caches."""
    return len(sizes.channels) == 1 and looks_ahead(sizes.states, sizes.channels)


@compiled_part
def moving_block(  # noqa: PLR0913
    sizes: Sizes, step: Step, number: int, z: Floats, row: int, state: State, block: Block, moving: Moving
) -> bool:
    """Run a block of readings whose gain still moves.

    False, and the state unchanged, where one of them is missing, where a state runs away, as in
    `settled_block`, or where the gains cannot be found by jumps.
    """
    if not move_gains(sizes, step, number, state.P, moving):
        return False
    n, x = len(sizes.states), block.x
    read_block(sizes, z, row, block)
    for i in range(n):
        x[i][0] = state.x[i]
    total = follow(sizes, step, block, moving)
    for i in range(n):
        total += x[i][BLOCK] * x[i][BLOCK]
    if not total <= TAME:
        return False
    leave(sizes, step, state, block, moving)
    return True


@compiled_part
def move_gains(sizes: Sizes, step: Step, number: int, P: Floats, moving: Moving) -> bool:
    """Find the gains of a block after a covariance P; False where jumps would lose digits or variances run away."""
    if not step.R[0, 0] > 0.0:
        return False
    prepare_jumps(sizes.states, step, number, moving.jumps)
    M = stack_matrix(sizes.states, sizes.states)
    copy_matrix(sizes.states, sizes.states, P, M)
    move(sizes, step.F, step.Q, M)
    set_row(sizes.states, M, moving.M, 0)
    leap_through(sizes.states, moving.jumps, moving.M)
    if not keeps_digits(sizes.states, moving.jumps, moving.M, moving.S):
        return False
    find_gains(sizes, step, moving)
    get_row(sizes.states, moving.M, BLOCK - 1, M)
    total = 0.0
    for i in range(len(sizes.states)):
        total += M[i, i]
    return bool(total <= TAME)


@compiled_part
def find_gains(sizes: Sizes, step: Step, moving: Moving) -> None:
    """Equations (4) and (5)."""
    n, h = len(sizes.states), step.H[0]
    M, MH = stack_matrix(sizes.states, sizes.states), stack_vector(sizes.states)
    for k in range(BLOCK):
        get_row(sizes.states, moving.M, k, M)
        S = step.R[0, 0]
        for i in range(n):
            MH[i] = 0.0
            for j in range(n):
                MH[i] += M[i, j] * h[j]
            S += h[i] * MH[i]
        moving.S[k] = S
        for i in range(n):
            moving.K[i][k] = MH[i] / S


@compiled_part
def follow(sizes: Sizes, step: Step, block: Block, moving: Moving) -> float:
    """Equations (1), (3) and (6) through a block; return the sum of the squared innovations."""
    n, x, z, nu, terms = len(sizes.states), block.x, block.z[0], block.nu[0], block.sums[0]
    HF, now, then = stack_matrix(sizes.channels, sizes.states), stack_vector(sizes.states), stack_vector(sizes.states)
    see_through(sizes, step.H, step.F, HF)
    for i in range(n):
        now[i] = x[i][0]
    for k in range(BLOCK):
        for i in range(n):
            s = moving.K[i][k] * z[k]
            for j in range(n):
                s += (step.F[i, j] - moving.K[i][k] * HF[0, j]) * now[j]
            then[i] = s
        for i in range(n):
            now[i] = then[i]
            x[i][k + 1] = then[i]
    innovate(sizes, HF, block)
    for k in range(BLOCK):
        terms[k] = nu[k] * nu[k]
    return add_up(terms)


@compiled_part
def leave(sizes: Sizes, step: Step, state: State, block: Block, moving: Moving) -> None:
    """Leave the state as after the last row of a block."""
    n, S, MH = len(sizes.states), moving.S[BLOCK - 1], stack_vector(sizes.states)
    state.D[0], state.nu[0], state.seen[0] = S, block.nu[0][BLOCK - 1], 1.0
    for i in range(n):
        state.x[i], state.K[i, 0] = block.x[i][BLOCK], moving.K[i][BLOCK - 1]
        MH[i] = S * state.K[i, 0]
    get_row(sizes.states, moving.M, BLOCK - 1, state.P)
    if 2.0 * step.R[0, 0] >= S:
        subtract(sizes, MH, state)
    else:
        joseph(sizes, step.H, step.R, state)


@compiled_part
def spread_moving(sizes: Sizes, step: Step, moving: Moving, sigma: Floats) -> None:
    """Write the standard deviation of H x of a block: P H' = K R once it is corrected."""
    combine(sizes.states, step.H[0], moving.K, 0, sigma)
    for k in range(BLOCK):
        sigma[k] = np.sqrt(max(step.R[0, 0] * sigma[k], 0.0))


@compiled_part
def score_moving(block: Block, moving: Moving) -> tuple[float, float]:
    """Return the sums of nu^2 / S and of log S over a block, (8)."""
    terms, S = block.sums[0], moving.S
    for k in range(BLOCK):
        terms[k] = block.nu[0][k] * block.nu[0][k] / S[k]
    squares = add_up(terms)
    return squares, sum_of_logs(S, terms)


@compiled_part
def sum_of_logs(S: Floats, terms: Floats) -> float:
    """Return the sum of log S over a block: a few logarithms, of products of all."""
    scale = 1.0 / S[0]
    for k in range(BLOCK):
        terms[k] = S[k] * scale
    half = BLOCK
    while half > _PRODUCTS:
        half //= 2
        for k in range(half):
            terms[k] *= terms[k + half]
    log_det, possible = 0.0, True
    for k in range(_PRODUCTS):
        possible = possible and _LEAST < terms[k] < 1.0 / _LEAST
        log_det += np.log(terms[k])
    if possible:
        return float(log_det + BLOCK * np.log(S[0]))
    log_det = 0.0
    for k in range(BLOCK):
        log_det += np.log(S[k])
    return float(log_det)
