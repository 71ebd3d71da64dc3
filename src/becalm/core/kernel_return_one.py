"""The way back through a block of one channel whose gain still moves; H P = R K' spares the covariances."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import BLOCK, Floats
from becalm.core.compiling import compiled_part
from becalm.core.kernel_ahead import Rows
from becalm.core.kernel_block import Block
from becalm.core.kernel_matrices import copy_matrix
from becalm.core.kernel_moving import Moving
from becalm.core.kernel_return import Future, pull_back_spread
from becalm.core.kernel_steps import close, see_through
from becalm.core.kernels import Trace
from becalm.core.sized import Sizes, across, stack_matrix, stack_vector
from becalm.core.system import Step


@compiled_part
def return_moving(  # noqa: PLR0913
    sizes: Sizes, step: Step, block: Block, moving: Moving, r: Rows, future: Future, trace: Trace, row: int
) -> None:
    """Equations (9) to (12) for a block whose gains `move_gains` has found; uses up block.sums.

    H P r = R K' r, so that H (x + P r) needs no states, only the prediction of the reading.
    """
    HF, told = stack_matrix(sizes.channels, sizes.states), block.sums[0]
    see_through(sizes, step.H, step.F, HF)
    if trace.sigma.shape[1]:
        return_spread(sizes, step, HF, moving, future, told)
        sigma = across(trace.sigma, 0, row, BLOCK)
        for k in range(BLOCK):
            sigma[k] = np.sqrt(max(told[k], 0.0))
    for k in range(BLOCK):
        told[k] = block.nu[0][k] / moving.S[k]
    return_means(sizes, step, HF, told, moving, r, future)
    if trace.signal.shape[1]:
        p, nu, signal = block.p[0], block.nu[0], across(trace.signal, 0, row, BLOCK)
        for k in range(BLOCK):
            s = p[k]
            for i in range(len(sizes.states)):
                s += moving.K[i][k] * (step.H[0, i] * nu[k] + step.R[0, 0] * r[i][k + 1])
            signal[k] = s


@compiled_part
def return_means(  # noqa: PLR0913
    sizes: Sizes, step: Step, HF: Floats, told: Floats, moving: Moving, r: Rows, future: Future
) -> None:
    """Equation (11): carry r back, what the rows from k on say of the state before row k; `told` is nu / S."""
    n, now, then = len(sizes.states), stack_vector(sizes.states), stack_vector(sizes.states)
    for i in range(n):
        now[i] = future.r[i]
        r[i][BLOCK] = now[i]
    for k in range(BLOCK - 1, -1, -1):
        for i in range(n):
            s = HF[0, i] * told[k]
            for j in range(n):
                s += (step.F[j, i] - moving.K[j][k] * HF[0, i]) * now[j]
            then[i] = s
        for i in range(n):
            now[i] = then[i]
            r[i][k] = then[i]
    for i in range(n):
        future.r[i] = now[i]


@compiled_part
def return_spread(  # noqa: PLR0913
    sizes: Sizes, step: Step, HF: Floats, moving: Moving, future: Future, variance: Floats
) -> None:
    """Equations (10) and (12): write the smoothed variance of H x of each row."""
    n, R = len(sizes.states), step.R[0, 0]
    N, A, C = (
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
    )
    K = stack_matrix(sizes.states, sizes.channels)
    copy_matrix(sizes.states, sizes.states, future.N, N)
    for k in range(BLOCK - 1, -1, -1):
        for i in range(n):
            K[i, 0] = moving.K[i][k]
        s = 0.0
        for i in range(n):
            s += step.H[0, i] * K[i, 0] * R
            for j in range(n):
                s -= R * K[i, 0] * N[i, j] * K[j, 0] * R
        variance[k] = s
        close(sizes, step.H, step.F, K, A)
        for i in range(n):
            for j in range(n):
                C[i, j] = HF[0, i] * HF[0, j] / moving.S[k]
        pull_back_spread(sizes, A, C, N)
    copy_matrix(sizes.states, sizes.states, N, future.N)
