"""A fixed lag in Numba: what the rows up to L later say of a row, told as soon as they are there.

From row k on, B = cov(C x_k, x_j) of its outputs with the state of a later row j is carried along:

    B = B F'                             (13) before reading j
    E = B H', Gamma = E S^-1             (14)
    y = y + Gamma nu,  V = V - Gamma E'  (15) the outputs and their covariance
    B = B - E K'                         (16) after it

Source: fixed-point smoothing, Anderson and Moore, Optimal Filtering (1979), section 7.2. Where the gain has
settled, the Gamma of all later rows are the same L weights for every k, and V is one number.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled, compiled_part, woven
from becalm.core.kernel_block import run_of, step_of
from becalm.core.kernel_gap import has_lost_digits, regress
from becalm.core.kernel_lag_window import ALIKE, ROWS, WEIGHED, Window, fetch, keep
from becalm.core.kernel_matrices import copy_matrix, solve
from becalm.core.kernel_return import inform, pull_back_spread, smooth_cov
from becalm.core.kernel_row import advance
from becalm.core.kernel_settling import LAST_STEP, LOAD, SAVE, SETTLED, new_watch, transfer
from becalm.core.kernel_steps import State, new_state, shrink, whiten
from becalm.core.kernels import Trace, write_innovation
from becalm.core.sized import Size, Sizes, layer, stack_matrix, stack_vector
from becalm.core.system import Record, Step, System

_MUCH = 1e-3  # of a variance: where less is left, the difference has lost its digits


class Walk(NamedTuple):
    """What is known of the outputs of a row, on the way to later ones; changed in place."""

    y: Floats  # (p,)
    V: Floats  # (p,) the diagonal
    V_0: Floats  # (p,) as it was when nothing later was known
    B: Floats  # (p, n)
    BF: Floats  # (n,)
    E: Floats  # (m,)
    Gamma: Floats  # (m,)


@woven
def new_walk(outputs: Size, sizes: Sizes) -> Walk:
    """Make room for a walk on the stack."""
    n, m = sizes
    return Walk(
        stack_vector(outputs), stack_vector(outputs), stack_vector(outputs), stack_matrix(outputs, n), stack_vector(n),
        stack_vector(m), stack_vector(m),
    )  # fmt: skip


@woven
def new_step(sizes: Sizes, system: System) -> Step:
    """Make room for a step on the stack, with the sensors of a system."""
    n, m = sizes
    return Step(stack_matrix(n, n), stack_matrix(n, n), layer(system.H, 0, m, n), layer(system.R, 0, m, m))


@compiled_part
def set_out(outputs: Size, sizes: Sizes, C: Floats, P: Floats, walk: Walk) -> None:
    """Start a walk from a row whose filtered covariance is P: B = C P, V = C P C'."""
    for a in range(len(outputs)):
        walk.V[a] = 0.0
        for i in range(len(sizes.states)):
            s = 0.0
            for j in range(len(sizes.states)):
                s += C[a, j] * P[j, i]
            walk.B[a, i] = s
            walk.V[a] += s * C[a, i]
        walk.V_0[a] = walk.V[a]


@compiled_part
def walk_on(sizes: Sizes, step: Step, state: State, a: int, walk: Walk) -> None:
    """Equations (13) to (16) for output a; `state` holds how the later row was taken, and its innovation."""
    n, m, s = len(sizes.states), len(sizes.channels), 0.0
    for i in range(n):
        s = 0.0
        for j in range(n):
            s += walk.B[a, j] * step.F[i, j]
        walk.BF[i] = s
    for c in range(m):
        s = 0.0
        for i in range(n):
            s += walk.BF[i] * step.H[c, i]
        walk.E[c] = walk.Gamma[c] = s * state.seen[c]
    solve(sizes.channels, state.L, state.D, walk.Gamma)
    for c in range(m):
        walk.Gamma[c] *= state.seen[c]
        walk.y[a] += walk.Gamma[c] * state.nu[c]
        walk.V[a] -= walk.Gamma[c] * walk.E[c]
    for i in range(n):
        s = walk.BF[i]
        for c in range(m):
            s -= walk.E[c] * state.K[i, c]
        walk.B[a, i] = s


@compiled_part
def walk_through(  # noqa: PLR0913
    outputs: Size, sizes: Sizes, C: Floats, window: Window, ahead: int, weigh: bool, step: Step, state: State,
    walk: Walk,
) -> None:  # fmt: skip
    """Walk from the row that has `ahead` later ones to the last; `weigh`: keep the Gamma of each as weights."""
    length = len(window.place)
    slot = (int(window.counters[ROWS]) - 1 - ahead) % length
    fetch(sizes, window, slot, step, state)
    set_out(outputs, sizes, C, state.P, walk)
    place, lost = window.place[slot], False
    for a in range(len(outputs)):
        walk.y[a] = window.y[slot, a]
    for i in range(ahead):
        slot = slot + 1 if slot + 1 < length else 0
        if window.place[slot] != place:
            fetch(sizes, window, slot, step, state)
            place = window.place[slot]
        for c in range(len(sizes.channels)):
            state.nu[c] = window.nu[c, slot]
        for a in range(len(outputs)):
            walk_on(sizes, step, state, a, walk)
            for c in range(len(sizes.channels) if weigh else 0):
                window.weights[a * len(sizes.channels) + c, i] = walk.Gamma[c]
    for a in range(len(outputs)):
        lost = lost or walk.V[a] < _MUCH * walk.V_0[a]
    if lost:
        come_back(sizes, window, ahead, step, state)
        set_out(outputs, sizes, C, state.P, walk)


@compiled_part
def come_back(sizes: Sizes, window: Window, ahead: int, step: Step, state: State) -> None:
    """Come back to a row from the last one, (12) and (10), from the row after where that keeps more digits.

    Its smoothed covariance is then in state.P.
    """
    n, m, length = len(sizes.states), len(sizes.channels), len(window.place)
    N, A, zero = (
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
    )
    told, G, smoothed = (
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.channels),
        stack_matrix(sizes.states, sizes.states),
    )
    F, Q, P = (
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
        stack_matrix(sizes.states, sizes.states),
    )
    for i in range(n):
        for j in range(n):
            N[i, j] = zero[i, j] = 0.0
    for back in range(ahead + 1):
        slot = (int(window.counters[ROWS]) - 1 - back) % length
        fetch(sizes, window, slot, step, state)
        smooth_cov(sizes, state.P, N, smoothed)
        if back and has_lost_digits(sizes.states, state.P, smoothed):
            regress(sizes, F, Q, state.P, P, smoothed)
        copy_matrix(sizes.states, sizes.states, smoothed, P)
        copy_matrix(sizes.states, sizes.states, step.F, F)
        copy_matrix(sizes.states, sizes.states, step.Q, Q)
        shrink(sizes, step.H, state.K, A)
        inform(sizes, step.H, state, G)
        for i in range(n):
            for j in range(n):
                told[i, j] = 0.0
                for c in range(m):
                    told[i, j] += G[i, c] * step.H[c, j]
        pull_back_spread(sizes, A, told, N)
        pull_back_spread(sizes, F, zero, N)
    copy_matrix(sizes.states, sizes.states, P, state.P)


@compiled_part
def weighted(weights: Floats, row: int, nu: Floats, c: int, first: int) -> float:
    """Return the weighted sum of the L innovations from a column on, in four sums side by side."""
    s, t, u, v, count = 0.0, 0.0, 0.0, 0.0, weights.shape[1]
    whole = count // 4 * 4
    for i in range(0, whole, 4):
        s += weights[row, i] * nu[c, first + i]
        t += weights[row, i + 1] * nu[c, first + i + 1]
        u += weights[row, i + 2] * nu[c, first + i + 2]
        v += weights[row, i + 3] * nu[c, first + i + 3]
    for i in range(whole, count):
        s += weights[row, i] * nu[c, first + i]
    return (s + t) + (u + v)


@compiled_part
def tell_late(  # noqa: PLR0913
    outputs: Size, sizes: Sizes, C: Floats, window: Window, ahead: int, step: Step, state: State, walk: Walk
) -> None:
    """Smooth the row that has `ahead` later ones: by the weights of a settled gain, or by walking there."""
    lag, counters = len(window.place) - 1, window.counters
    settled = ahead == lag and counters[ALIKE] > ahead
    if not settled or not counters[WEIGHED]:
        walk_through(outputs, sizes, C, window, ahead, settled, step, state, walk)
        for a in range(len(outputs) if settled else 0):
            window.variance[a], counters[WEIGHED] = walk.V[a], 1.0
        if not settled:
            return
    newest = (int(counters[ROWS]) - 1) % (lag + 1)
    for a in range(len(outputs)):
        s = window.y[(newest + 1) % (lag + 1), a]
        for c in range(len(sizes.channels)):
            s += weighted(window.weights, a * len(sizes.channels) + c, window.nu, c, newest + 2)
        walk.y[a], walk.V[a] = s, window.variance[a]


@compiled
def run_late(  # noqa: PLR0913  (a door for Python: what is read, what moves, what is written)
    outputs: Size, sizes: Sizes, C: Floats, system: System, record: Record, begun: int, stop: int, enough: float,
    memory: Floats, window: Window, trace: Trace,
) -> tuple[float, float, int, int]:  # fmt: skip
    """Filter the rows of a record from `begun` to `stop`, and smooth with each the row that is L before it.

    `memory` (M,) holds the state before them, and the state after them when done. What is told stands at the
    row that was waited for; NaN, with sigma inf, where no row is L before it.

    Returns what `kernels.forward` does.
    """
    state, watch, walk = new_state(sizes), new_watch(sizes), new_walk(outputs, sizes)
    then, later = new_state(sizes), new_step(sizes, system)
    transfer(sizes, state, watch, memory, LOAD)
    squares, log_det, used, first, run, lag = 0.0, 0.0, 0, -1, 0, len(window.place) - 1
    rows = layer(C, 0, outputs, sizes.states)
    for row in range(begun, stop):
        run = run_of(record, row, run)
        number = record.step[run]
        step = step_of(sizes, system, number)
        alike = watch.counters[SETTLED] >= enough and watch.counters[LAST_STEP] == number
        advance(sizes, step, number, record.z, row, state, watch, enough)
        alike = alike and watch.counters[SETTLED] >= enough
        first = row if first < 0 and alike else first
        keep(outputs, sizes, rows, step, alike, state, window)
        s, d, dimension = whiten(sizes, state)
        squares, log_det, used = squares + s, log_det + d, used + dimension
        write_innovation(sizes, trace, row, record.z[row], state)
        if window.counters[ROWS] > lag:
            tell_late(outputs, sizes, rows, window, lag, later, then, walk)
        for a in range(len(outputs)):
            known = window.counters[ROWS] > lag
            trace.signal[a, row] = walk.y[a] if known else np.nan
            trace.sigma[a, row] = np.sqrt(max(walk.V[a], 0.0)) if known else np.inf
    transfer(sizes, state, watch, memory, SAVE)
    return squares, log_det, used, first


@compiled
def open_window(  # noqa: PLR0913
    outputs: Size, sizes: Sizes, C: Floats, system: System, memory: Floats, window: Window
) -> None:
    """Put the row that left a memory (M,) into an empty window: the last one of an opening."""
    state, watch = new_state(sizes), new_watch(sizes)
    transfer(sizes, state, watch, memory, LOAD)
    keep(outputs, sizes, layer(C, 0, outputs, sizes.states), step_of(sizes, system, 0), False, state, window)


@compiled
def run_out(  # noqa: PLR0913
    outputs: Size, sizes: Sizes, C: Floats, system: System, window: Window, signal: Floats, sigma: Floats
) -> None:
    """Smooth the last rows with what there is after them; signal and sigma are (p, rows)."""
    state, walk, later = new_state(sizes), new_walk(outputs, sizes), new_step(sizes, system)
    count = signal.shape[1]
    for k in range(count):
        tell_late(outputs, sizes, layer(C, 0, outputs, sizes.states), window, count - 1 - k, later, state, walk)
        for a in range(len(outputs)):
            signal[a, k] = walk.y[a]
            sigma[a, k] = np.sqrt(max(walk.V[a], 0.0))
