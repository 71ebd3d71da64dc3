"""The way back through a block of one channel whose gain still moves; H P = R K' spares the covariances."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part
from becalm.core.kernel_ahead import BLOCK, combine, multiply
from becalm.core.kernel_block import Block
from becalm.core.kernel_moving import Moving
from becalm.core.kernel_one import Reach, new_reach, reach_back
from becalm.core.kernel_return import Future, pull_back_spread
from becalm.core.kernel_steps import Step, shrink
from becalm.core.kernels import Trace
from becalm.core.sized import Sizes, across, stack_matrix, stack_vector


@compiled_part
def return_moving(  # noqa: PLR0913
    sizes: Sizes, step: Step, block: Block, moving: Moving, future: Future, trace: Trace, row: int
) -> None:
    """Equations (9) to (12) for a block that `moving_block` has run; uses up its sums."""
    reach = new_reach(sizes)
    reach_back(sizes, step, reach)
    if trace.sigma.shape[1]:
        return_spread(sizes, step, reach, moving, future, block.sums[0])
        sigmas, variances = across(trace.sigma, 0, row, BLOCK), block.sums[0]
        for k in range(BLOCK):
            sigmas[k] = np.sqrt(max(variances[k], 0.0))
    return_means(sizes, step, reach, block, moving, future)
    if trace.signal.shape[1]:
        signal, change = across(trace.signal, 0, row, BLOCK), block.sums[0]
        combine(sizes.states, step.H[0], block.x, 1, signal)
        for k in range(BLOCK):
            signal[k] += step.R[0, 0] * change[k]


@compiled_part
def return_means(  # noqa: PLR0913
    sizes: Sizes, step: Step, reach: Reach, block: Block, moving: Moving, future: Future
) -> None:
    """Equation (11): carry r back, and leave K' r of each row in block.sums."""
    n, now, then = len(sizes.states), stack_vector(sizes.states), stack_vector(sizes.states)
    for i in range(n):
        now[i] = future.r[i]
    for k in range(BLOCK - 1, -1, -1):
        w = 0.0
        for i in range(n):
            w += moving.K[i][k] * now[i]
        block.sums[0][k] = w
        u = (block.nu[0][k] / moving.S[k] if moving.S[k] > 0.0 else 0.0) - w
        for i in range(n):
            s = reach.g[i] * u
            for j in range(n):
                s += step.F[j, i] * now[j]
            then[i] = s
        for i in range(n):
            now[i] = then[i]
    for i in range(n):
        future.r[i] = now[i]


@compiled_part
def return_spread(  # noqa: PLR0913
    sizes: Sizes, step: Step, reach: Reach, moving: Moving, future: Future, variance: Floats
) -> None:
    """Equations (10) and (12): write the smoothed variance of H x of each row."""
    n, R = len(sizes.states), step.R[0, 0]
    N, A, C = (
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
    )
    shrunk, K = stack_matrix(sizes.states, sizes.states), stack_matrix(sizes.states, sizes.channels)
    carry(sizes, future.N, N)
    for k in range(BLOCK - 1, -1, -1):
        for i in range(n):
            K[i, 0] = moving.K[i][k]
        s = 0.0
        for i in range(n):
            s += step.H[0, i] * K[i, 0] * R
            for j in range(n):
                s -= R * K[i, 0] * N[i, j] * K[j, 0] * R
        variance[k] = s
        shrink(sizes, step.H, K, shrunk)
        multiply(sizes.states, sizes.states, shrunk, step.F, A)
        weight = 1.0 / moving.S[k] if moving.S[k] > 0.0 else 0.0
        for i in range(n):
            for j in range(n):
                C[i, j] = weight * reach.g[i] * reach.g[j]
        pull_back_spread(sizes, A, C, N)
    carry(sizes, N, future.N)


@compiled_part
def carry(sizes: Sizes, A: Floats, B: Floats) -> None:
    """B = A."""
    for i in range(len(sizes.states)):
        for j in range(len(sizes.states)):
            B[i, j] = A[i, j]
