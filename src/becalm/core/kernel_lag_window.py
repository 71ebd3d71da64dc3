"""The window of a fixed lag in Numba: how the last L + 1 rows were taken, and what they read.

Rows with a settled gain are all taken in the same way, which is therefore kept once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.compiling import compiled_part
from becalm.core.kernel_settling import LOAD, SAVE, transfer_matrix, transfer_vector
from becalm.core.kernel_steps import State
from becalm.core.sized import Size, Sizes
from becalm.core.system import Step

ROWS, ALIKE, PLACE, WEIGHED = 0, 1, 2, 3


class Window(NamedTuple):
    """The last L + 1 rows; changed in place."""

    y: Floats  # (L + 1, p) filtered outputs, in a ring
    nu: Floats  # (m, 2 L + 2) innovations, in a ring that is there twice, so that any L are in one piece
    place: Integers  # (L + 1,) where in `taken` it stands how each row was taken; with a settled gain it is one place
    taken: Floats  # (L + 2, t) P, K, L, D, seen, F, Q of rows that were taken in a way of their own
    weights: Floats  # (p m, L) Gamma of the rows after one whose gain, and theirs, has settled
    variance: Floats  # (p,) of its outputs
    counters: Floats  # (4,) rows so far; the last ones that were taken alike; their place; whether weights are theirs


def new_window(outputs: int, states: int, channels: int, lag: int) -> Window:
    """Make room for a lag of L rows, in which none was taken yet."""
    p, n, m = outputs, states, channels
    return Window(
        y=np.zeros((lag + 1, p)),
        nu=np.zeros((m, 2 * lag + 2)),
        place=np.zeros(lag + 1, dtype=np.int64),
        taken=np.zeros((lag + 2, 3 * n * n + n * m + m * m + 2 * m)),
        weights=np.zeros((p * m, lag)),
        variance=np.zeros(p),
        counters=np.zeros(4),
    )


def newest_taken(window: Window, n: int, m: int) -> list[Floats]:
    """Return P, K, L, D, seen, F, Q of the newest row, and its innovations (m,)."""
    slot = (int(window.counters[ROWS]) - 1) % len(window.place)
    shapes = [(n, n), (n, m), (m, m), (m,), (m,), (n, n), (n, n)]
    bounds = np.cumsum([np.prod(shape) for shape in shapes])[:-1]
    parts = np.split(window.taken[window.place[slot]], bounds)
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)] + [window.nu[:, slot]]


@compiled_part
def transfer_taken(sizes: Sizes, step: Step, state: State, taken: Floats, saving: float) -> None:
    """Save in `taken` (t,) how a row was taken, or load it."""
    n, m = sizes
    at = transfer_matrix(n, n, state.P, taken, 0, saving)
    at = transfer_matrix(n, m, state.K, taken, at, saving)
    at = transfer_matrix(m, m, state.L, taken, at, saving)
    at = transfer_vector(m, state.D, taken, at, saving)
    at = transfer_vector(m, state.seen, taken, at, saving)
    at = transfer_matrix(n, n, step.F, taken, at, saving)
    transfer_matrix(n, n, step.Q, taken, at, saving)


@compiled_part
def keep(outputs: Size, sizes: Sizes, C: Floats, step: Step, alike: bool, state: State, window: Window) -> None:  # noqa: PLR0913
    """Put a row that was just filtered into the window, `alike` where it was taken as the one before."""
    length, counters = len(window.place), window.counters
    slot = int(counters[ROWS]) % length
    if not alike or counters[ALIKE] == 0.0:
        counters[PLACE] = float((int(counters[PLACE]) + 1) % len(window.taken))
        transfer_taken(sizes, step, state, window.taken[int(counters[PLACE])], SAVE)
        counters[ALIKE], counters[WEIGHED] = 0.0, 0.0
    counters[ALIKE] += 1.0
    counters[ROWS] += 1.0
    window.place[slot] = int(counters[PLACE])
    for a in range(len(outputs)):
        s = 0.0
        for i in range(len(sizes.states)):
            s += C[a, i] * state.x[i]
        window.y[slot, a] = s
    for c in range(len(sizes.channels)):
        window.nu[c, slot] = state.nu[c]
        window.nu[c, slot + length] = state.nu[c]


@compiled_part
def fetch(sizes: Sizes, window: Window, slot: int, step: Step, state: State) -> None:
    """Load how the row in a slot was taken, and its innovation."""
    transfer_taken(sizes, step, state, window.taken[window.place[slot]], LOAD)
    for c in range(len(sizes.channels)):
        state.nu[c] = window.nu[c, slot]
