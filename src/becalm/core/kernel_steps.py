"""Single steps of the numbered equations in Numba: the twins of `reference.predict` and `update`.

Every function works in place on a `State`, whose scratch arrays spare the loops any allocation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.compiling import compiled_part

SETTLED, STEADY, NEXT_CHECK, LAST_STEP = 0, 1, 2, 3
FIRST_CHECK = 64
_UNCHANGED = 1e-13
_LARGEST = 1e200  # an unobservable, unstable state saturates here and cannot spoil the others
_DEAD_PIVOT = 1e-15


class System(NamedTuple):
    """Step matrices of u different lengths, and the sensors."""

    F: Floats  # (u, n, n)
    Q: Floats  # (u, n, n)
    H: Floats  # (m, n)
    R: Floats  # (m, m)


class State(NamedTuple):
    """All that moves; changed in place. The last five are scratch and carry nothing over."""

    x: Floats  # (n,)
    P: Floats  # (n, n)
    K: Floats  # (n, m) gain, one column a channel seen
    L: Floats  # (m, m) unit lower triangle of S = L D L'
    D: Floats  # (m,) pivots of S; 0 where a channel carries no new information
    checkpoint: Floats  # (n, n) covariance when last compared
    counters: Integers  # (4,) settled, steady, next check, last step
    seen: Integers  # (m,) which channels arrived
    nu: Floats  # (m,) innovations of the channels seen
    S: Floats  # (m, m)
    nn: Floats  # (2, n, n)
    nm: Floats  # (n, m)


def new_state(x: Floats, P: Floats, channels: int) -> State:
    """Make a state to start from; x (n,) and P (n, n) are copied."""
    n, m = len(x), channels
    return State(
        x=np.array(x, dtype=np.float64),
        P=np.array(P, dtype=np.float64),
        K=np.zeros((n, m)),
        L=np.eye(m),
        D=np.zeros(m),
        checkpoint=np.zeros((n, n)),
        counters=np.array([0, 0, FIRST_CHECK, -2], dtype=np.int64),
        seen=np.zeros(m, dtype=np.int64),
        nu=np.zeros(m),
        S=np.zeros((m, m)),
        nn=np.zeros((2, n, n)),
        nm=np.zeros((n, m)),
    )


@compiled_part
def copy_vector(source: Floats, target: Floats) -> None:
    """Copy (n,) numbers."""
    for i in range(len(source)):
        target[i] = source[i]


@compiled_part
def copy_matrix(source: Floats, target: Floats) -> None:
    """Copy (n, n) numbers."""
    for i in range(len(source)):
        for j in range(len(source)):
            target[i, j] = source[i, j]


@compiled_part
def saturate(P: Floats) -> None:
    """Shrink what has grown beyond measure, row and column alike, so that P stays a covariance."""
    for i in range(len(P)):
        if P[i, i] > _LARGEST:
            factor = np.sqrt(_LARGEST / P[i, i])
            for j in range(len(P)):
                P[i, j] *= factor
                P[j, i] *= factor


@compiled_part
def predict(F: Floats, Q: Floats, state: State) -> None:
    """Equations (1) and (2)."""
    x, P, FP, Fx = state.x, state.P, state.nn[0], state.nn[1, 0]
    n = len(x)
    for i in range(n):
        s = 0.0
        for k in range(n):
            s += F[i, k] * x[k]
        Fx[i] = s
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += F[i, k] * P[k, j]
            FP[i, j] = s
    for i in range(n):
        x[i] = min(max(Fx[i], -_LARGEST), _LARGEST)
        for j in range(i + 1):
            s = Q[i, j]
            for k in range(n):
                s += FP[i, k] * F[j, k]
            P[i, j] = s
            P[j, i] = s
    saturate(P)


@compiled_part
def look(reading: Floats, state: State) -> int:
    """Note the channels that arrived; return how many."""
    count = 0
    for c in range(len(reading)):
        if np.isfinite(reading[c]):
            state.seen[count] = c
            count += 1
    return count


@compiled_part
def decompose(state: State, count: int) -> None:
    """Factor S = L D L'; a pivot that rounding alone has left is dead."""
    S, L, D = state.S, state.L, state.D
    for a in range(count):
        d = S[a, a]
        for c in range(a):
            d -= L[a, c] * L[a, c] * D[c]
        D[a] = d if d > _DEAD_PIVOT * S[a, a] else 0.0
        for b in range(a + 1, count):
            s = S[b, a]
            for c in range(a):
                s -= L[b, c] * L[a, c] * D[c]
            L[b, a] = s / D[a] if D[a] > 0.0 else 0.0


@compiled_part
def factor(H: Floats, R: Floats, state: State, count: int) -> None:
    """Equation (4), S = H P H' + R of the channels seen, and its factors L D L'."""
    P, PH, S, seen = state.P, state.nm, state.S, state.seen
    n = len(P)
    for a in range(count):
        for i in range(n):
            s = 0.0
            for j in range(n):
                s += P[i, j] * H[seen[a], j]
            PH[i, a] = s
    for a in range(count):
        for b in range(a + 1):
            s = R[seen[a], seen[b]]
            for i in range(n):
                s += H[seen[a], i] * PH[i, b]
            S[a, b] = s
            S[b, a] = s
    decompose(state, count)


@compiled_part
def gain(state: State, count: int) -> None:
    """Equation (5), K = P H' S^-1, from the factors."""
    K, L, D, PH = state.K, state.L, state.D, state.nm
    for i in range(len(state.x)):
        for a in range(count):
            s = PH[i, a]
            for c in range(a):
                s -= L[a, c] * K[i, c]
            K[i, a] = s
        for a in range(count):
            K[i, a] = K[i, a] / D[a] if D[a] > 0.0 else 0.0
        for a in range(count - 1, -1, -1):
            for c in range(a + 1, count):
                K[i, a] -= L[c, a] * K[i, c]


@compiled_part
def shrink(H: Floats, state: State, count: int) -> None:
    """Write A = I - K H of the channels seen into nn[0]."""
    A, K = state.nn[0], state.K
    for i in range(len(A)):
        for j in range(len(A)):
            s = 1.0 if i == j else 0.0
            for a in range(count):
                s -= K[i, a] * H[state.seen[a], j]
            A[i, j] = s


@compiled_part
def joseph(H: Floats, R: Floats, state: State, count: int) -> None:
    """Equation (7), P = A P A' + K R K'."""
    P, K, seen, A, AP = state.P, state.K, state.seen, state.nn[0], state.nn[1]
    shrink(H, state, count)
    n = len(P)
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
            for a in range(count):
                for b in range(count):
                    s += K[i, a] * R[seen[a], seen[b]] * K[j, b]
            P[i, j] = s
            P[j, i] = s


@compiled_part
def correct(H: Floats, state: State, reading: Floats, count: int) -> None:
    """Equations (3) and (6): the innovation, and the state that it corrects."""
    x, K, nu = state.x, state.K, state.nu
    for a in range(count):
        s = reading[state.seen[a]]
        for i in range(len(x)):
            s -= H[state.seen[a], i] * x[i]
        nu[a] = s
    for i in range(len(x)):
        s = x[i]
        for a in range(count):
            s += K[i, a] * nu[a]
        x[i] = s


@compiled_part
def full_step(system: System, step: int, reading: Floats, state: State) -> int:
    """One step of the full recursion, (1) to (7); returns how many channels were seen."""
    if step >= 0:
        predict(system.F[step], system.Q[step], state)
    count = look(reading, state)
    if count:
        factor(system.H, system.R, state, count)
        gain(state, count)
        correct(system.H, state, reading, count)
        joseph(system.H, system.R, state, count)
    return count


@compiled_part
def settled_step(system: System, step: int, reading: Floats, state: State) -> None:
    """Equations (1), (3), (6) with the gain that has settled; the covariance stays."""
    x, Fx, F = state.x, state.nn[1, 0], system.F[step]
    for i in range(len(x)):
        s = 0.0
        for k in range(len(x)):
            s += F[i, k] * x[k]
        Fx[i] = min(max(s, -_LARGEST), _LARGEST)
    copy_vector(Fx, x)
    correct(system.H, state, reading, look(reading, state))


@compiled_part
def watch(state: State, step: int, complete: bool) -> None:
    """Notice that the covariance has settled: the same now as at half of the stretch."""
    counters, P = state.counters, state.P
    if not complete or step != counters[LAST_STEP]:
        counters[SETTLED], counters[STEADY], counters[NEXT_CHECK] = 0, 0, FIRST_CHECK
        counters[LAST_STEP] = step if complete else -2
        return
    counters[STEADY] += 1
    if counters[STEADY] < counters[NEXT_CHECK]:
        return
    counters[NEXT_CHECK] *= 2
    unchanged = 1
    for i in range(len(P)):
        for j in range(len(P)):
            if not abs(P[i, j] - state.checkpoint[i, j]) <= _UNCHANGED * np.sqrt(P[i, i]) * np.sqrt(P[j, j]):
                unchanged = 0
            state.checkpoint[i, j] = P[i, j]
    counters[SETTLED] = unchanged


@compiled_part
def whiten(state: State, count: int) -> tuple[float, float, int]:
    """Return nu' S^-1 nu, log det S and their dimension from the factors; dead pivots are left out (8)."""
    L, D, e = state.L, state.D, state.S[0]
    squares, log_det, live = 0.0, 0.0, 0
    for a in range(count):
        s = state.nu[a]
        for c in range(a):
            s -= L[a, c] * e[c]
        e[a] = s
        if D[a] > 0.0:
            squares += s * s / D[a]
            log_det += np.log(D[a])
            live += 1
    return squares, log_det, live
