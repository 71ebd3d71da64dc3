"""The likelihood of one channel and nothing else: what tuning asks for, dozens of times a channel.

The same recursion as `kernels.forward`, with everything of one channel kept in plain numbers.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.compiling import compiled, compiled_part
from becalm.core.kernel_steps import LAST_STEP, SETTLED, State, System, predict, watch


@compiled_part
def learn(h: Floats, r: float, z: float, state: State) -> float:
    """Equations (3) to (7) of one channel; leaves S in D and the gain in K, and returns the innovation."""
    x, P, K, PH = state.x, state.P, state.K, state.nm
    n = len(x)
    S, nu = r, z
    for i in range(n):
        s = 0.0
        for j in range(n):
            s += P[i, j] * h[j]
        PH[i, 0] = s
        S += h[i] * s
        nu -= h[i] * x[i]
    state.D[0] = S
    for i in range(n):
        K[i, 0] = PH[i, 0] / S
        x[i] += K[i, 0] * nu
    joseph_of_one(h, r, state)
    return nu


@compiled_part
def joseph_of_one(h: Floats, r: float, state: State) -> None:
    """Equation (7), P = A P A' + K r K'."""
    P, K, A, AP = state.P, state.K, state.nn[0], state.nn[1]
    n = len(P)
    for i in range(n):
        for j in range(n):
            A[i, j] = (1.0 if i == j else 0.0) - K[i, 0] * h[j]
    for i in range(n):
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += A[i, k] * P[k, j]
            AP[i, j] = s
    for i in range(n):
        for j in range(i + 1):
            s = K[i, 0] * r * K[j, 0]
            for k in range(n):
                s += AP[i, k] * A[j, k]
            P[i, j] = s
            P[j, i] = s


@compiled_part
def settled_run(system: System, which: Integers, z: Floats, first: int, state: State) -> tuple[int, float]:
    """Run on with the settled gain; returns the row it stopped at and the sum of nu^2."""
    n, step = len(state.x), state.counters[LAST_STEP]
    F, h, K = system.F[step], system.H[0], state.K[:, 0]
    x, Fx = state.x, state.nn[1, 0]
    total, k = 0.0, first
    while k < len(z) and which[k] == step:
        nu = z[k]
        for i in range(n):
            s = 0.0
            for j in range(n):
                s += F[i, j] * x[j]
            Fx[i] = s
            nu -= h[i] * s
        for i in range(n):
            x[i] = Fx[i] + K[i] * nu
        total += nu * nu
        k += 1
    return k, total


@compiled
def score(system: System, which: Integers, z: Floats, state: State, scored_from: int) -> tuple[float, float, int]:
    """Return the sums of nu^2 / S and of log S over the rows from `scored_from` on, and their number.

    z (N,) must be finite, and R positive.
    """
    squares, log_det, k = 0.0, 0.0, 0
    h, r = system.H[0], system.R[0, 0]
    while k < len(z):
        if state.counters[SETTLED] and k >= scored_from:
            stop, total = settled_run(system, which, z, k, state)
            squares += total / state.D[0]
            log_det += (stop - k) * np.log(state.D[0])
            k = stop
            state.counters[SETTLED] = 0
            continue
        if which[k] >= 0:
            predict(system.F[which[k]], system.Q[which[k]], state)
        nu = learn(h, r, z[k], state)
        watch(state, which[k], True)
        if k >= scored_from:
            squares += nu * nu / state.D[0]
            log_det += np.log(state.D[0])
        k += 1
    return squares, log_det, max(len(z) - scored_from, 0)
