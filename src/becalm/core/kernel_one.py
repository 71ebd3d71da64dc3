"""One channel in as short a chain of operations as can be, for the rows before a gain has settled.

Each row waits for the covariance of the row before, so what counts is not how much is computed but how
long the longest chain is. S needs no predicted covariance: with g = H F it is g P g' + H Q H' + R.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_ahead import BLOCK, Rows, add_up, combine
from becalm.core.kernel_block import TAME, Block
from becalm.core.kernel_steps import LARGEST, State, Step, joseph, move, new_state
from becalm.core.sized import Sizes, stack_rows, stack_vector

_PRODUCTS = 16  # of a block's numbers, whose logarithms are taken
_LEAST = 1e-280


class Moving(NamedTuple):
    """What changes from row to row of a block while its gain still moves."""

    S: Floats  # (BLOCK,) innovation variance
    K: Rows  # n of (BLOCK,)


@woven
def new_moving(sizes: Sizes) -> Moving:
    """Make room for it on the stack."""
    return Moving(stack_rows(sizes.channels, BLOCK)[0], stack_rows(sizes.states, BLOCK))


class Reach(NamedTuple):
    """What a reading says of the state one step before."""

    g: Floats  # (n,) H F
    QH: Floats  # (n,) Q H'
    c: Floats  # (1,) H Q H' + R


@woven
def new_reach(sizes: Sizes) -> Reach:
    """Make room for a reach on the stack."""
    return Reach(stack_vector(sizes.states), stack_vector(sizes.states), stack_vector(sizes.channels))


@compiled_part
def reach_back(sizes: Sizes, step: Step, reach: Reach) -> None:
    """Fill in what follows from a step."""
    reach.c[0] = step.R[0, 0]
    for i in range(len(sizes.states)):
        reach.g[i], reach.QH[i] = 0.0, 0.0
        for j in range(len(sizes.states)):
            reach.g[i] += step.H[0, j] * step.F[j, i]
            reach.QH[i] += step.Q[i, j] * step.H[0, j]
        reach.c[0] += step.H[0, i] * reach.QH[i]


@compiled_part
def take_one(sizes: Sizes, step: Step, reach: Reach, reading: float, state: State) -> None:
    """Equations (1) to (7) of a reading that arrived."""
    n, F, P = len(sizes.states), step.F, state.P
    Fx, t, PH = stack_vector(sizes.states), stack_vector(sizes.states), stack_vector(sizes.states)
    S, nu = reach.c[0], reading
    for i in range(n):
        Fx[i], t[i] = 0.0, 0.0
        for j in range(n):
            Fx[i] += F[i, j] * state.x[j]
            t[i] += P[i, j] * reach.g[j]
        Fx[i] = min(max(Fx[i], -LARGEST), LARGEST)
        nu -= step.H[0, i] * Fx[i]
        S += reach.g[i] * t[i]
    for i in range(n):
        PH[i] = reach.QH[i]
        for j in range(n):
            PH[i] += F[i, j] * t[j]
    move(sizes, F, step.Q, P)
    state.D[0], state.nu[0] = S, nu
    for i in range(n):
        state.K[i, 0] = PH[i] / S if S > 0.0 else 0.0
        state.x[i] = Fx[i] + state.K[i, 0] * nu
    if 2.0 * step.R[0, 0] >= S:
        subtract(sizes, PH, state)
    else:
        joseph(sizes, step.H, step.R, state)


@compiled_part
def subtract(sizes: Sizes, PH: Floats, state: State) -> None:
    """Equation (7) as P - K (P H')': no variance loses more than half where S <= 2 R, so no more than one bit."""
    for i in range(len(sizes.states)):
        for j in range(i + 1):
            s = state.P[i, j] - state.K[i, 0] * PH[j]
            state.P[i, j] = s
            state.P[j, i] = s


@compiled_part
def moving_block(sizes: Sizes, step: Step, state: State, block: Block, moving: Moving) -> bool:
    """Run a block of readings, there in block.z, whose gain still moves.

    False, and nothing done, where one of them is missing or a state runs away, as in `settled_block`.
    """
    n, reach, own = len(sizes.states), new_reach(sizes), new_state(sizes)
    reach_back(sizes, step, reach)
    copy_belief(sizes, state, own)  # of this loop alone, so that it stays in registers
    for i in range(n):
        block.x[i][0] = own.x[i]
    for k in range(BLOCK):
        take_one(sizes, step, reach, block.z[0][k], own)
        for i in range(n):
            block.x[i][k + 1], moving.K[i][k] = own.x[i], own.K[i, 0]
        block.nu[0][k], moving.S[k] = own.nu[0], own.D[0]
    terms = block.sums[0]
    for k in range(BLOCK):
        terms[k] = block.nu[0][k] * block.nu[0][k]
    total = add_up(terms)
    for i in range(n):
        total += own.x[i] * own.x[i]
    if not total <= TAME:
        return False
    copy_belief(sizes, own, state)
    state.D[0], state.nu[0], state.seen[0] = own.D[0], own.nu[0], 1.0
    for i in range(n):
        state.K[i, 0] = own.K[i, 0]
    return True


@compiled_part
def spread_moving(sizes: Sizes, step: Step, moving: Moving, sigma: Floats) -> None:
    """Write the standard deviation of H x of a block: P H' = K R once it is corrected."""
    combine(sizes.states, step.H[0], moving.K, 0, sigma)
    for k in range(BLOCK):
        sigma[k] = np.sqrt(max(step.R[0, 0] * sigma[k], 0.0))


@compiled_part
def copy_belief(sizes: Sizes, source: State, target: State) -> None:
    """Copy x and P."""
    for i in range(len(sizes.states)):
        target.x[i] = source.x[i]
        for j in range(len(sizes.states)):
            target.P[i, j] = source.P[i, j]


@compiled_part
def score_moving(R: float, block: Block, moving: Moving) -> tuple[float, float, int]:
    """Return the sums of nu^2 / S and of log S over a block, and their number; the dead are left out (8)."""
    terms, S, live, squares, log_det = block.sums[0], moving.S, 0, 0.0, 0.0
    if not R > 0.0:
        for k in range(BLOCK):
            if S[k] > 0.0:
                squares += block.nu[0][k] * block.nu[0][k] / S[k]
                log_det += np.log(S[k])
                live += 1
        return squares, log_det, live
    for k in range(BLOCK):
        terms[k] = block.nu[0][k] * block.nu[0][k] / S[k]
    squares = add_up(terms)
    return squares, sum_of_logs(S, terms), BLOCK


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
