"""When a gain has settled, and what is remembered of a filter to tell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_matrices import copy_matrix, multiply
from becalm.core.kernel_steps import State, close
from becalm.core.sized import Size, Sizes, size, stack_matrix, stack_vector
from becalm.core.system import Step

SIX: Size = size(6)
SETTLED, STEADY, NEXT_CHECK, LAST_STEP, AGREED, PROVEN = 0, 1, 2, 3, 4, 5
GAIN, COVARIANCE = 1.0, 2.0
"""What has settled: the gain, or the covariance as well."""

FIRST_CHECK = 32.0
_STRETCHED = 1.125  # the next check comes when the stretch has grown by this
_UNCHANGED = 1e-13
_STEADY = 1e-9  # of a variance
_FORGOTTEN = 0.9  # what the last eighth of a stretch may leave of the spread before it
NO_STEP = -2.0
LOAD, SAVE = 0.0, 1.0


class Watch(NamedTuple):
    """What is compared to notice that a gain has settled; changed in place."""

    K: Floats  # (n, m) as it was at the last check, and so are the next three
    L: Floats  # (m, m)
    D: Floats  # (m,)
    P: Floats  # (n, n)
    counters: Floats  # (6,) what has settled, rows since the last gap, next check, last step, checks that
    # agreed one after the other, and what they have proven


@woven
def new_watch(sizes: Sizes) -> Watch:
    """Make room for a watch on the stack."""
    n, m = sizes
    return Watch(stack_matrix(n, m), stack_matrix(m, m), stack_vector(m), stack_matrix(n, n), stack_vector(SIX))


def new_memory(x: Floats, P: Floats, channels: int, rows: int = 1) -> Floats:
    """Make a memory to start from: rows that each hold a State and its Watch, of which the first is set."""
    n, m = len(x), channels
    counters = _counters_at(n, m)
    memory = np.zeros((rows, counters + len(SIX) + 2 * m))
    memory[0, :n] = x
    memory[0, n : n + n * n] = np.ravel(P)
    memory[0, counters : counters + len(SIX)] = 0.0, 0.0, FIRST_CHECK, NO_STEP, 0.0, 0.0
    return memory


def rename_last_step(memory: Floats, n: int, m: int, number: int | None) -> None:
    """Say which number the last step before a memory (M,) has from now on; None if it has none."""
    memory[_counters_at(n, m) + LAST_STEP] = NO_STEP if number is None else number


def _counters_at(n: int, m: int) -> int:
    return n + 2 * n * n + 2 * n * m + 2 * m * m + 2 * m


@compiled_part
def transfer_vector(extent: Size, own: Floats, memory: Floats, at: int, saving: float) -> int:
    """Save (extent,) numbers in memory, or load them; return where the next ones are."""
    for i in range(len(extent)):
        if saving:
            memory[at + i] = own[i]
        else:
            own[i] = memory[at + i]
    return at + len(extent)


@compiled_part
def transfer_matrix(rows: Size, columns: Size, own: Floats, memory: Floats, at: int, saving: float) -> int:  # noqa: PLR0913
    """Save (rows, columns) numbers in memory, or load them; return where the next ones are."""
    for i in range(len(rows)):
        for j in range(len(columns)):
            if saving:
                memory[at] = own[i, j]
            else:
                own[i, j] = memory[at]
            at += 1
    return at


@compiled_part
def transfer(sizes: Sizes, state: State, watch: Watch, memory: Floats, saving: float) -> int:
    """Save a state and its watch in a row of memory, or load them from it; return the column after them."""
    n, m = sizes.states, sizes.channels
    at = transfer_vector(n, state.x, memory, 0, saving)
    at = transfer_matrix(n, n, state.P, memory, at, saving)
    at = transfer_matrix(n, m, state.K, memory, at, saving)
    at = transfer_matrix(m, m, state.L, memory, at, saving)
    at = transfer_vector(m, state.D, memory, at, saving)
    at = transfer_matrix(n, m, watch.K, memory, at, saving)
    at = transfer_matrix(m, m, watch.L, memory, at, saving)
    at = transfer_vector(m, watch.D, memory, at, saving)
    at = transfer_matrix(n, n, watch.P, memory, at, saving)
    at = transfer_vector(SIX, watch.counters, memory, at, saving)
    at = transfer_vector(m, state.nu, memory, at, saving)
    return transfer_vector(m, state.seen, memory, at, saving)


@compiled_part
def near(now: float, then: float, scale: float) -> bool:
    """Whether a number has kept its value; NaN and Inf have not."""
    return abs(now - then) <= _UNCHANGED * scale


@compiled_part
def compare(sizes: Sizes, state: State, watch: Watch) -> float:
    """Tell what has settled since the last check, measured by the state's own spread, and remember it anew."""
    n, m = len(sizes.states), len(sizes.channels)
    P, K, L, D = state.P, state.K, state.L, state.D
    gain, covariance = True, True
    for a in range(m):
        gain = gain and near(D[a], watch.D[a], D[a])
        watch.D[a] = D[a]
        for b in range(a):
            gain = gain and near(L[a, b], watch.L[a, b], 1.0 + abs(L[a, b]))
            watch.L[a, b] = L[a, b]
        for i in range(n):
            steady = abs(P[i, i] - watch.P[i, i]) <= _STEADY * P[i, i]  # else a gain may be small, and grow
            spread = np.sqrt(P[i, i] / D[a]) if steady and D[a] > 0.0 else 0.0
            gain = gain and near(K[i, a], watch.K[i, a], spread + abs(K[i, a]))
            watch.K[i, a] = K[i, a]
    for i in range(n):
        for j in range(n):
            covariance = covariance and near(P[i, j], watch.P[i, j], np.sqrt(P[i, i]) * np.sqrt(P[j, j]))
            watch.P[i, j] = P[i, j]
    return (COVARIANCE if covariance else GAIN) if gain else 0.0


@compiled_part
def forgets(sizes: Sizes, step: Step, state: State, rows: float) -> bool:
    """Whether signals forget within some rows, or half as many, a tenth at least of what was believed before.

    What is left of a deviation of P is the closed loop's power, on both sides of it; a gain that is slow to
    forget only creeps, and would be the same an eighth before wherever it is.
    """
    n, A = len(sizes.states), stack_matrix(sizes.states, sizes.states)
    squared = stack_matrix(sizes.states, sizes.states)
    close(sizes, step.H, step.F, state.K, A)
    while rows >= 2.0:
        multiply(sizes.states, sizes.states, A, A, squared)
        copy_matrix(sizes.states, sizes.states, squared, A)
        rows *= 0.5
    forgotten = True
    for c in range(len(sizes.channels)):
        before, left = 0.0, 0.0
        for i in range(n):
            s, spread = 0.0, np.sqrt(state.P[i, i])
            for j in range(n):
                s += step.H[c, j] * A[j, i]
            before += abs(step.H[c, i]) * spread
            left += abs(s) * spread
        forgotten = forgotten and left <= _FORGOTTEN * before
    return forgotten


@compiled_part
def notice(  # noqa: PLR0913
    sizes: Sizes, step: Step, number: float, state: State, watch: Watch, rows: float
) -> None:
    """Notice, after some complete rows, that the gain has settled; rows = 0 stands for a row that is not complete.

    It is the same now as an eighth of the stretch before, and stays so for n rows more, lest it comes
    back at every check and moves between them, as an oscillator's can.
    """
    counters, complete = watch.counters, rows > 0.0
    if not complete or number != counters[LAST_STEP]:
        counters[SETTLED], counters[STEADY], counters[NEXT_CHECK], counters[AGREED] = 0.0, -1.0, FIRST_CHECK, 0.0
        counters[LAST_STEP] = number if complete else NO_STEP
        watch.D[0] = -1.0  # a check must not find what another stretch has left
    counters[STEADY] += max(rows, 1.0)
    if counters[STEADY] < counters[NEXT_CHECK]:
        return
    same = compare(sizes, state, watch)
    if same > 0.0 and not forgets(sizes, step, state, 0.125 * counters[STEADY]):
        same = 0.0
    counters[PROVEN] = min(same, counters[PROVEN]) if counters[AGREED] > 0.0 else same
    counters[AGREED] = counters[AGREED] + 1.0 if same > 0.0 else 0.0
    if 0.0 < counters[AGREED] <= len(sizes.states):
        counters[NEXT_CHECK] = counters[STEADY] + 1.0
        return
    counters[SETTLED], counters[AGREED] = counters[PROVEN], 0.0
    counters[NEXT_CHECK] = max(counters[STEADY] + FIRST_CHECK, counters[STEADY] * _STRETCHED)
