"""The way back through a block of rows with a settled gain: r is a recursion like the state's, run backwards."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import BLOCK, Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_ahead import AFTER, Loop, Rows, combine, fill, new_loop, prepare, run_back, run_block
from becalm.core.kernel_block import Block
from becalm.core.kernel_matrices import multiply, solve
from becalm.core.kernel_settling import FIRST_CHECK, NEXT_CHECK, SETTLED, STEADY, near
from becalm.core.kernel_steps import State
from becalm.core.kernels import Trace, spread, write_cov
from becalm.core.sized import Sizes, across, stack_matrix, stack_rows, stack_vector

LATER = 3


class Future(NamedTuple):
    """What the later readings say of the state; changed in place."""

    r: Floats  # (n,)
    N: Floats  # (n, n)
    then: Floats  # (n, n) N as it was at the last check
    P: Floats  # (n, n) smoothed covariance of the row after
    F: Floats  # (n, n) of the step to it
    Q: Floats  # (n, n) of the step to it
    counters: Floats  # (4,) settled, rows since the last gap, next check, whether P, F and Q are known


def new_future(n: int) -> Future:
    """Make the future of the last row, of which nothing is known."""
    after = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    return Future(np.zeros(n), np.zeros((n, n)), np.full((n, n), -1.0), *after, np.array([0.0, 0.0, FIRST_CHECK, 0.0]))


class Return(NamedTuple):
    """The way back through a block with a settled gain."""

    loop: Loop  # of r: the transposed closed loop
    C: Floats  # (n, n) what one row adds to N
    HP: Floats  # (m, n)
    HK: Floats  # (m, m)
    r: Rows  # n of (BLOCK + 1,) what the rows from k on say of the state before row k; at the end, of the last


@woven
def new_return(sizes: Sizes) -> Return:
    """Make room for a way back on the stack."""
    n, m = sizes
    return Return(new_loop(n, m), stack_matrix(n, n), stack_matrix(m, n), stack_matrix(m, m), stack_rows(n, AFTER))


@compiled_part
def inform(sizes: Sizes, H: Floats, state: State, G: Floats) -> None:
    """Write G = H' S^-1 (n, m) of the channels seen."""
    m, v = len(sizes.channels), stack_vector(sizes.channels)
    for i in range(len(sizes.states)):
        for a in range(m):
            v[a] = H[a, i] * state.seen[a]
        solve(sizes.channels, state.L, state.D, v)
        for a in range(m):
            G[i, a] = v[a] * state.seen[a]


@compiled_part
def smooth_cov(sizes: Sizes, P: Floats, N: Floats, smoothed: Floats) -> None:
    """Equation (10), P - P N P."""
    PN = stack_matrix(sizes.states, sizes.states)
    multiply(sizes.states, sizes.states, P, N, PN)
    multiply(sizes.states, sizes.states, PN, P, smoothed)
    for i in range(len(sizes.states)):
        for j in range(i + 1):
            s = P[i, j] - smoothed[i, j]
            smoothed[i, j] = s
            smoothed[j, i] = s


@compiled_part
def prepare_return(  # noqa: PLR0913
    sizes: Sizes, H: Floats, HF: Floats, state: State, loop: Loop, back: Return
) -> None:
    """Fill in what the way back through settled blocks needs, once for all of them."""
    n, m = len(sizes.states), len(sizes.channels)
    inform(sizes, HF, state, back.loop.G)
    for i in range(n):
        for j in range(n):
            back.loop.A[i, j] = loop.A[j, i]
            s = 0.0
            for a in range(m):
                s += back.loop.G[i, a] * HF[a, j]
            back.C[i, j] = s
        for a in range(m):
            s = 0.0
            for j in range(n):
                s += H[a, j] * state.P[j, i]
            back.HP[a, i] = s
    for a in range(m):
        for b in range(m):
            s = 0.0
            for i in range(n):
                s += H[a, i] * state.K[i, b]
            back.HK[a, b] = s
    prepare(sizes.states, sizes.channels, back.loop)


@compiled_part
def return_through(sizes: Sizes, block: Block, back: Return, future: Future) -> None:
    """Carry r back through a block, (11), and leave it at each row."""
    for i in range(len(sizes.states)):
        back.r[i][BLOCK] = future.r[i]
    run_back(sizes.states, sizes.channels, back.loop, block.nu, back.r)
    for i in range(len(sizes.states)):
        future.r[i] = back.r[i][0]


@compiled_part
def write_smoothed_block(sizes: Sizes, trace: Trace, row: int, block: Block, back: Return) -> None:
    """Equation (9) for the signal of a block: H (x + P r) = H F x- + H K nu + H P r, which needs no states."""
    for c in range(len(sizes.channels) if trace.signal.shape[1] else 0):
        p, signal = block.p[c], across(trace.signal, c, row, BLOCK)
        for k in range(BLOCK):
            s = p[k]
            for a in range(len(sizes.channels)):
                s += back.HK[c, a] * block.nu[a][k]
            for i in range(len(sizes.states)):
                s += back.HP[c, i] * back.r[i][k + 1]
            signal[k] = s


@compiled_part
def write_smoothed_means(  # noqa: PLR0913
    sizes: Sizes, trace: Trace, row: int, state: State, loop: Loop, block: Block, back: Return
) -> None:
    """Equation (9) for a block, whose states are found again; uses up block.sums."""
    x, change = block.x, block.sums[0]
    for i in range(len(sizes.states)):
        x[i][0] = state.x[i]
    run_block(sizes.states, sizes.channels, loop, block.z, x)
    for i in range(len(sizes.states)):
        mean = across(trace.mean, i, row, BLOCK)
        combine(sizes.states, state.P[i], back.r, 1, change)
        for k in range(BLOCK):
            mean[k] = x[i][k + 1] + change[k]


@compiled_part
def write_spread_block(  # noqa: PLR0913
    sizes: Sizes, trace: Trace, row: int, H: Floats, P: Floats, A: Floats, C: Floats, future: Future
) -> None:
    """Equations (10) and (12) for a block: row by row until N has settled, then once for all rows."""
    smoothed = stack_matrix(sizes.states, sizes.states)
    if future.counters[SETTLED] > 0.0:
        smooth_cov(sizes, P, future.N, smoothed)
        for c in range(len(sizes.channels)):
            fill(across(trace.sigma, c, row, BLOCK), spread(sizes, H, smoothed, c))
        for k in range(BLOCK if trace.cov.shape[2] else 0):
            write_cov(sizes, trace, row + k, smoothed)
        return
    for k in range(BLOCK - 1, -1, -1):
        smooth_cov(sizes, P, future.N, smoothed)
        pull_back_spread(sizes, A, C, future.N)
        for c in range(len(sizes.channels)):
            trace.sigma[c, row + k] = spread(sizes, H, smoothed, c)
        if trace.cov.shape[2]:
            write_cov(sizes, trace, row + k, smoothed)
    notice_spread(sizes, future)


@compiled_part
def pull_back_spread(sizes: Sizes, A: Floats, C: Floats, N: Floats) -> None:
    """Equation (12) through a linear map that a reading follows or precedes: N = A' N A + C."""
    n, NA = len(sizes.states), stack_matrix(sizes.states, sizes.states)
    multiply(sizes.states, sizes.states, N, A, NA)
    for i in range(n):
        for j in range(i + 1):
            s = C[i, j]
            for k in range(n):
                s += A[k, i] * NA[k, j]
            N[i, j] = s
            N[j, i] = s


@compiled_part
def notice_spread(sizes: Sizes, future: Future) -> None:
    """Notice that N has settled: the same now as an eighth of the stretch before."""
    counters, N = future.counters, future.N
    counters[STEADY] += BLOCK
    if counters[STEADY] < counters[NEXT_CHECK]:
        return
    counters[NEXT_CHECK] = max(counters[STEADY] + FIRST_CHECK, counters[STEADY] * 1.125)
    settled = True
    for i in range(len(sizes.states)):
        for j in range(len(sizes.states)):
            settled = settled and near(N[i, j], future.then[i, j], np.sqrt(N[i, i]) * np.sqrt(N[j, j]))
            future.then[i, j] = N[i, j]
    counters[SETTLED] = 1.0 if settled else 0.0
