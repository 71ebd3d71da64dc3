"""What the rows after one say of its state: information, and the covariance that it leaves."""

from __future__ import annotations

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part
from becalm.core.kernel_matrices import multiply, solve
from becalm.core.kernel_steps import State
from becalm.core.sized import Sizes, stack_matrix, stack_vector


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
