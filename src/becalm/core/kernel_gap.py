"""Smoothed covariances where later readings tell nearly all, as towards the end of a long gap.

P - P N P then has lost its digits. The covariance of the row after has not: given x', the state before it
is C x' + ... with C = F^-1 (I - Q M^-1) and the covariance C Q F'^-1, where M = F P F' + Q. Source: the
reverse-time model, Anderson and Moore, Optimal Filtering (1979), chapter 10.
"""

from __future__ import annotations

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part
from becalm.core.kernel_matrices import copy_matrix, factor, invert, multiply, solve
from becalm.core.kernel_steps import move
from becalm.core.sized import Size, Sizes, stack_matrix, stack_vector

_MUCH = 1e-3


@compiled_part
def has_lost_digits(states: Size, P: Floats, smoothed: Floats) -> bool:
    """Whether a difference from P leaves a small part of some variance, or less than nothing."""
    lost = False
    for i in range(len(states)):
        lost = lost or smoothed[i, i] < _MUCH * P[i, i]
    return lost


@compiled_part
def regress(sizes: Sizes, F: Floats, Q: Floats, P: Floats, later: Floats, smoothed: Floats) -> None:  # noqa: PLR0913
    """Write the smoothed covariance of a row from the one `later`; not where F has no inverse."""
    n = len(sizes.states)
    M, L, D = (
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
        stack_vector(sizes.states),
    )
    C, back, v = (
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
        stack_vector(sizes.states),
    )
    copy_matrix(sizes.states, sizes.states, P, M)
    move(sizes, F, Q, M)
    factor(sizes.states, M, L, D)
    for i in range(n):
        for j in range(n):
            v[j] = Q[i, j]
        solve(sizes.states, L, D, v)
        for j in range(n):
            M[i, j] = (1.0 if i == j else 0.0) - v[j]
    if not invert(sizes.states, F, back):
        return
    multiply(sizes.states, sizes.states, back, M, C)
    multiply(sizes.states, sizes.states, C, later, M)
    multiply(sizes.states, sizes.states, C, Q, L)
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(n):
                s += M[i, k] * C[j, k] + L[i, k] * back[j, k]
            smoothed[i, j] = s
            smoothed[j, i] = s
