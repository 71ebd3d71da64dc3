"""Many readings in Numba, forward and backward: the twins of `reference.filter_readings` and `smooth`.

A gain that has settled is used as it is: once the covariance has stayed the same over half of the
time since the last gap, its recursion stops, and starts anew where a reading is missing.
"""

from __future__ import annotations

from typing import NamedTuple

from becalm.core.arrays import Floats, Integers
from becalm.core.compiling import compiled, compiled_part
from becalm.core.kernel_steps import (
    LAST_STEP,
    SETTLED,
    State,
    System,
    copy_matrix,
    copy_vector,
    factor,
    full_step,
    gain,
    look,
    predict,
    settled_step,
    shrink,
    watch,
    whiten,
)


class Trace(NamedTuple):
    """Where results go; an array without rows is not wanted."""

    signal: Floats  # (N, m) H x
    variance: Floats  # (N, m) diagonal of H P H'
    innovation: Floats  # (N, m)
    innovation_variance: Floats  # (N, m) diagonal of S
    mean: Floats  # (N, n)
    cov: Floats  # (N, n, n)


@compiled_part
def write_row(trace: Trace, k: int, H: Floats, state: State) -> None:
    """Write what is believed after reading k."""
    n = len(state.x)
    for a in range(trace.signal.shape[1] if len(trace.signal) else 0):
        y = v = 0.0
        for i in range(n):
            y += H[a, i] * state.x[i]
            for j in range(n):
                v += H[a, i] * state.P[i, j] * H[a, j]
        trace.signal[k, a] = y
        trace.variance[k, a] = max(v, 0.0)
    if len(trace.mean):
        copy_vector(state.x, trace.mean[k])
    if len(trace.cov):
        copy_matrix(state.P, trace.cov[k])


@compiled_part
def write_innovation(trace: Trace, k: int, system: System, state: State, count: int) -> None:
    """Write the innovations of reading k and, before them, their variances."""
    for a in range(count):
        c = state.seen[a]
        trace.innovation[k, c] = state.nu[a]
        s = 0.0  # the diagonal of L D L'
        for b in range(a):
            s += state.L[a, b] * state.L[a, b] * state.D[b]
        trace.innovation_variance[k, c] = s + state.D[a]


@compiled
def forward(system: System, which: Integers, z: Floats, state: State, trace: Trace) -> tuple[float, float, int]:
    """Filter readings z (N, m); `which` (N,) names each row's step, -1 for no step before it.

    Returns the sums of nu' S^-1 nu and of log det S, and the number of readings used.
    """
    m = len(system.H)
    squares, log_det, used = 0.0, 0.0, 0
    for k in range(len(z)):
        complete = look(z[k], state) == m
        count = m
        if state.counters[SETTLED] and complete and which[k] == state.counters[LAST_STEP]:
            settled_step(system, which[k], z[k], state)
        else:
            count = full_step(system, which[k], z[k], state)
            watch(state, which[k], complete)
        s, d, live = whiten(state, count)
        squares += s
        log_det += d
        used += live
        if len(trace.innovation):
            write_innovation(trace, k, system, state, count)
        write_row(trace, k, system.H, state)
    return squares, log_det, used


class Future(NamedTuple):
    """What the later readings say of the state; changed in place."""

    r: Floats  # (n,)
    N: Floats  # (n, n)
    work: Floats  # (2, n, n)


@compiled_part
def write_smoothed(trace: Trace, k: int, H: Floats, state: State, future: Future) -> None:
    """Equations (9) and (10), written over row k; `state` holds the filtered belief."""
    x, P, r, N = state.x, state.P, future.r, future.N
    n, PN = len(x), future.work[0]
    for i in range(n):
        for j in range(n):
            s = 0.0
            for g in range(n):
                s += P[i, g] * N[g, j]
            PN[i, j] = s
    for i in range(n):
        s = 0.0
        for g in range(n):
            s += P[i, g] * r[g]
        x[i] += s
    smoothed = future.work[1]
    for i in range(n):
        for j in range(i + 1):
            s = P[i, j]
            for g in range(n):
                s -= PN[i, g] * P[g, j]
            smoothed[i, j] = s
            smoothed[j, i] = s
    copy_matrix(smoothed, P)
    write_row(trace, k, H, state)


@compiled_part
def pull_back(A: Floats, future: Future, u: Floats) -> None:
    """Carry r and N back through one linear map: r = A' r, N = A' N A; u is scratch."""
    r, N, NA = future.r, future.N, future.work[1]
    n = len(r)
    for i in range(n):
        s = 0.0
        for k in range(n):
            s += A[k, i] * r[k]
        u[i] = s
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += N[i, k] * A[k, j]
            NA[i, j] = s
    copy_vector(u, r)
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(n):
                s += A[k, i] * NA[k, j]
            N[i, j] = s
            N[j, i] = s


@compiled_part
def add_innovation(H: Floats, state: State, count: int, future: Future) -> None:
    """Add H' S^-1 nu to r and H' S^-1 H to N, from the factors L D L' of S."""
    L, D, seen, V, e = state.L, state.D, state.seen, state.nm, state.S[0]
    n = len(future.r)
    for a in range(count):  # V = H' L^-T, e = L^-1 nu
        s = state.nu[a]
        for c in range(a):
            s -= L[a, c] * e[c]
        e[a] = s
        for i in range(n):
            s = H[seen[a], i]
            for c in range(a):
                s -= L[a, c] * V[i, c]
            V[i, a] = s
    for a in range(count):
        weight = 1.0 / D[a] if D[a] > 0.0 else 0.0
        for i in range(n):
            future.r[i] += V[i, a] * e[a] * weight
            for j in range(n):
                future.N[i, j] += V[i, a] * V[j, a] * weight


@compiled_part
def step_back(F: Floats, H: Floats, state: State, count: int, future: Future) -> None:
    """Equations (11) and (12); `state` holds the prediction, its gain and the innovation."""
    shrink(H, state, count)
    pull_back(state.nn[0], future, state.x)
    add_innovation(H, state, count, future)
    pull_back(F, future, state.x)


@compiled
def backward(system: System, which: Integers, trace: Trace, state: State, future: Future) -> None:
    """Smooth what `forward` wrote, in place, from the last row to row 0; mean and cov must be there.

    Afterwards `future` holds what rows 1, 2, ... say of the filtered state of row 0.
    """
    for k in range(len(which) - 1, -1, -1):
        copy_vector(trace.mean[k], state.x)
        copy_matrix(trace.cov[k], state.P)
        write_smoothed(trace, k, system.H, state, future)
        if k == 0:
            return
        step = which[k]
        copy_vector(trace.mean[k - 1], state.x)
        copy_matrix(trace.cov[k - 1], state.P)
        predict(system.F[step], system.Q[step], state)
        count = look(trace.innovation[k], state)
        factor(system.H, system.R, state, count)
        gain(state, count)
        for a in range(count):
            state.nu[a] = trace.innovation[k, state.seen[a]]
        step_back(system.F[step], system.H, state, count, future)
