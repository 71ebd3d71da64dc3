"""Smoothed covariances where later readings tell nearly all, as towards the end of a long gap.

P - P N P then has lost its digits. The covariance of the row after has not: given x', the state before it
is C x' + ... with C = F^-1 (I - Q M^-1) and the covariance C Q F'^-1, where M = F P F' + Q. Source: the
reverse-time model, Anderson and Moore, Optimal Filtering (1979), chapter 10.
"""

from __future__ import annotations

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part
from becalm.core.kernel_steps import copy_matrix, factor, move, multiply, solve
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
    n, both = len(sizes.states), Sizes(sizes.states, sizes.states)
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
    factor(both, M, L, D)
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


@compiled_part
def invert(states: Size, A: Floats, B: Floats) -> bool:
    """B = A^-1, by Gauss and Jordan with pivots from the column; False where there is none."""
    n, own = len(states), stack_matrix(states, states)
    copy_matrix(states, states, A, own)
    for i in range(n):
        for j in range(n):
            B[i, j] = 1.0 if i == j else 0.0
    for c in range(n):
        p = c
        for i in range(c + 1, n):
            p = i if abs(own[i, c]) > abs(own[p, c]) else p
        if not abs(own[p, c]) > 0.0:
            return False
        scale = 1.0 / own[p, c]
        for j in range(n):
            own[p, j], own[c, j] = own[c, j], own[p, j] * scale
            B[p, j], B[c, j] = B[c, j], B[p, j] * scale
        for i in range(n):
            weight = own[i, c] if i != c else 0.0
            for j in range(n):
                own[i, j] -= weight * own[c, j]
                B[i, j] -= weight * B[c, j]
    return True
