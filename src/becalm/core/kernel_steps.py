"""Single steps of the numbered equations in Numba: the twins of `reference.predict` and `update`.

A channel that did not arrive keeps its place: its row of H counts as zero, its variance as one and
its innovation as zero, so that every loop has a length that the compiler knows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_matrices import factor, multiply
from becalm.core.sized import Sizes, stack_matrix, stack_vector
from becalm.core.verdict import BEYOND_ANY_SENSOR

LARGEST = 1e200  # an unobservable, unstable state saturates here and cannot spoil the others
LARGEST_READING = BEYOND_ANY_SENSOR


class State(NamedTuple):
    """What is believed after a reading, and how it was learnt; changed in place."""

    x: Floats  # (n,)
    P: Floats  # (n, n)
    K: Floats  # (n, m) gain; a zero column for a channel that is missing
    L: Floats  # (m, m) unit lower triangle of S = L D L'
    D: Floats  # (m,) pivots of S; 0 where a channel carries no new information
    nu: Floats  # (m,) innovations
    seen: Floats  # (m,) 1 where a channel arrived, else 0


@woven
def new_state(sizes: Sizes) -> State:
    """Make room for a state on the stack."""
    n, m = sizes
    return State(
        stack_vector(n),
        stack_matrix(n, n),
        stack_matrix(n, m),
        stack_matrix(m, m),
        stack_vector(m),
        stack_vector(m),
        stack_vector(m),
    )


@compiled_part
def saturate(sizes: Sizes, P: Floats) -> None:
    """Shrink what has grown beyond measure, row and column alike, so that P stays a covariance."""
    for i in range(len(sizes.states)):
        if P[i, i] > LARGEST:
            factor = np.sqrt(LARGEST / P[i, i])
            for j in range(len(sizes.states)):
                P[i, j] *= factor
                P[j, i] *= factor


@compiled_part
def move(sizes: Sizes, F: Floats, Q: Floats, P: Floats) -> None:
    """Equation (2), P = F P F' + Q."""
    n, FP = len(sizes.states), stack_matrix(sizes.states, sizes.states)
    for i in range(n):
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += F[i, k] * P[k, j]
            FP[i, j] = s
    for i in range(n):
        for j in range(i + 1):
            s = Q[i, j]
            for k in range(n):
                s += FP[i, k] * F[j, k]
            P[i, j] = s
            P[j, i] = s
    saturate(sizes, P)


@compiled_part
def predict(sizes: Sizes, F: Floats, Q: Floats, state: State) -> None:
    """Equations (1) and (2)."""
    n, Fx = len(sizes.states), stack_vector(sizes.states)
    for i in range(n):
        s = 0.0
        for k in range(n):
            s += F[i, k] * state.x[k]
        Fx[i] = s
    for i in range(n):
        state.x[i] = min(max(Fx[i], -LARGEST), LARGEST)
    move(sizes, F, Q, state.P)


@compiled_part
def look(sizes: Sizes, readings: Floats, row: int, state: State) -> int:
    """Note which channels of a row of readings (N, m) arrived; return how many."""
    count = 0
    for c in range(len(sizes.channels)):
        arrived = abs(readings[row, c]) <= LARGEST_READING
        state.seen[c] = 1.0 if arrived else 0.0
        count += arrived
    return count


@compiled_part
def weigh(sizes: Sizes, H: Floats, R: Floats, state: State) -> None:
    """Equations (4) and (5): S = H P H' + R as L D L', and the gain K = P H' S^-1."""
    n, m, seen = len(sizes.states), len(sizes.channels), state.seen
    S = stack_matrix(sizes.channels, sizes.channels)
    for a in range(m):
        for i in range(n):
            s = 0.0
            for j in range(n):
                s += state.P[i, j] * H[a, j]
            state.K[i, a] = s * seen[a]  # P H', for now
    for a in range(m):
        for b in range(a + 1):
            s = R[a, b]
            for i in range(n):
                s += H[a, i] * state.K[i, b]
            S[a, b] = s * seen[a] * seen[b]
        S[a, a] += 1.0 - seen[a]
    factor(sizes.channels, S, state.L, state.D)
    divide(sizes, state)


@compiled_part
def divide(sizes: Sizes, state: State) -> None:
    """Equation (5): K holds P H' and becomes P H' S^-1."""
    m, K, L, D = len(sizes.channels), state.K, state.L, state.D
    for i in range(len(sizes.states)):
        for a in range(m):
            for c in range(a):
                K[i, a] -= L[a, c] * K[i, c]
        for a in range(m):
            K[i, a] = K[i, a] / D[a] if D[a] > 0.0 else 0.0
        for a in range(m - 1, -1, -1):
            for c in range(a + 1, m):
                K[i, a] -= L[c, a] * K[i, c]


@compiled_part
def shrink(sizes: Sizes, H: Floats, K: Floats, A: Floats) -> None:
    """Write I - K H into A (n, n)."""
    n, m = len(sizes.states), len(sizes.channels)
    for i in range(n):
        for j in range(n):
            s = 1.0 if i == j else 0.0
            for a in range(m):
                s -= K[i, a] * H[a, j]
            A[i, j] = s


@compiled_part
def see_through(sizes: Sizes, H: Floats, F: Floats, HF: Floats) -> None:
    """Write H F (m, n)."""
    for c in range(len(sizes.channels)):
        for i in range(len(sizes.states)):
            s = 0.0
            for j in range(len(sizes.states)):
                s += H[c, j] * F[j, i]
            HF[c, i] = s


@compiled_part
def close(sizes: Sizes, H: Floats, F: Floats, K: Floats, A: Floats) -> None:
    """Write the closed loop, (I - K H) F."""
    shrunk = stack_matrix(sizes.states, sizes.states)
    shrink(sizes, H, K, shrunk)
    multiply(sizes.states, sizes.states, shrunk, F, A)


@compiled_part
def joseph(sizes: Sizes, H: Floats, R: Floats, state: State) -> None:
    """Equation (7), P = A P A' + K R K' with A = I - K H."""
    n, m = len(sizes.states), len(sizes.channels)
    P, K = state.P, state.K
    A, AP = stack_matrix(sizes.states, sizes.states), stack_matrix(sizes.states, sizes.states)
    shrink(sizes, H, K, A)
    for i in range(n):
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += A[i, k] * P[k, j]
            AP[i, j] = s
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(n):
                s += AP[i, k] * A[j, k]
            for a in range(m):
                for b in range(m):
                    s += K[i, a] * R[a, b] * K[j, b]
            P[i, j] = s
            P[j, i] = s


@compiled_part
def correct(sizes: Sizes, H: Floats, readings: Floats, row: int, state: State) -> None:
    """Equations (3) and (6): the innovation, and the state that it corrects."""
    n, m = len(sizes.states), len(sizes.channels)
    x, K, nu = state.x, state.K, state.nu
    for a in range(m):
        s = readings[row, a] if state.seen[a] else 0.0
        for i in range(n):
            s -= H[a, i] * x[i] * state.seen[a]
        nu[a] = s
    for i in range(n):
        s = x[i]
        for a in range(m):
            s += K[i, a] * nu[a]
        x[i] = s


@compiled_part
def settled_step(  # noqa: PLR0913
    sizes: Sizes, F: Floats, H: Floats, readings: Floats, row: int, state: State
) -> None:
    """Equations (1), (3), (6) with the gain that has settled; the covariance stays."""
    n = len(sizes.states)
    Fx = stack_vector(sizes.states)
    for i in range(n):
        s = 0.0
        for k in range(n):
            s += F[i, k] * state.x[k]
        Fx[i] = s
    for i in range(n):
        state.x[i] = min(max(Fx[i], -LARGEST), LARGEST)
    correct(sizes, H, readings, row, state)


@compiled_part
def whiten(sizes: Sizes, state: State) -> tuple[float, float, int]:
    """Return nu' S^-1 nu, log det S and their dimension from the factors; dead pivots are left out (8)."""
    L, D, e = state.L, state.D, stack_vector(sizes.channels)
    squares, log_det, live = 0.0, 0.0, 0
    for a in range(len(sizes.channels)):
        s = state.nu[a]
        for c in range(a):
            s -= L[a, c] * e[c]
        e[a] = s
        if D[a] > 0.0 and state.seen[a]:
            squares += s * s / D[a]
            log_det += np.log(D[a])
            live += 1
    return squares, log_det, live
