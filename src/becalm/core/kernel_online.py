"""A reading or a block at a time in Numba, with all that is needed in one array.

The array holds the State and its Watch as `kernel_settling.transfer` lays them out, then F, Q, H, R
and a flag for the first reading: one argument, because every argument of a call costs time.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled, compiled_part, woven
from becalm.core.kernel_block import TAME
from becalm.core.kernel_row import advance
from becalm.core.kernel_settling import (
    GAIN,
    LAST_STEP,
    LOAD,
    SAVE,
    SETTLED,
    Watch,
    new_memory,
    new_watch,
    transfer,
    transfer_matrix,
)
from becalm.core.kernel_steps import State, close, new_state
from becalm.core.kernels import spread
from becalm.core.model import Model
from becalm.core.sized import Size, Sizes, size, stack_matrix, stack_vector
from becalm.core.system import Step

ONE: Size = size(1)


def new_live(model: Model, x: Floats, P: Floats, *, fresh: bool) -> Floats:
    """Lay a model and its state out; `fresh` where no reading was taken and no step precedes the first."""
    system = (model.F, model.process_covariance, model.H, model.R)
    memory = new_memory(x, P, model.channels)[0]
    return np.concatenate([memory, *(np.ravel(matrix) for matrix in system), [1.0 if fresh else 0.0]])


class Held(NamedTuple):
    """What a settled gain spares the work of computing anew; changed in place."""

    A: Floats  # (n, n) closed loop, (I - K H) F
    sigma: Floats  # (m,)
    ready: Floats  # (1,) 1 where A and sigma are those of the settled gain


@woven
def new_held(sizes: Sizes) -> Held:
    """Make room for what is held on the stack."""
    return Held(stack_matrix(sizes.states, sizes.states), stack_vector(sizes.channels), stack_vector(ONE))


@woven
def new_step(sizes: Sizes) -> Step:
    """Make room for a step on the stack."""
    n, m = sizes
    return Step(stack_matrix(n, n), stack_matrix(n, n), stack_matrix(m, n), stack_matrix(m, m))


@compiled_part
def load(sizes: Sizes, live: Floats, state: State, watch: Watch, model: Step, held: Held) -> int:  # noqa: PLR0913
    """Load all from the array; return where its flag for the first reading is."""
    n, m = sizes
    at = transfer(sizes, state, watch, live, LOAD)
    at = transfer_matrix(n, n, model.F, live, at, LOAD)
    at = transfer_matrix(n, n, model.Q, live, at, LOAD)
    at = transfer_matrix(m, n, model.H, live, at, LOAD)
    held.ready[0] = 0.0
    return transfer_matrix(m, m, model.R, live, at, LOAD)


@compiled_part
def take(  # noqa: PLR0913
    sizes: Sizes, live: Floats, at: int, step: Step, z: Floats, row: int, state: State, watch: Watch, held: Held
) -> None:
    """Take one row; `at` is where the flag for the first reading is."""
    if watch.counters[SETTLED] > 0.0 and watch.counters[LAST_STEP] == 0.0:
        if not held.ready[0]:
            hold(sizes, step, state, held)
        if closed_step(sizes, z, row, state, held.A):
            return
    advance(sizes, step, -1 if live[at] > 0.0 else 0, z, row, state, watch, GAIN)
    live[at] = held.ready[0] = 0.0
    for c in range(len(sizes.channels)):
        held.sigma[c] = spread(sizes, step.H, state.P, c)


@compiled_part
def hold(sizes: Sizes, step: Step, state: State, held: Held) -> None:
    """Fill in what is held."""
    close(sizes, step.H, step.F, state.K, held.A)
    for c in range(len(sizes.channels)):
        held.sigma[c] = spread(sizes, step.H, state.P, c)
    held.ready[0] = 1.0


@compiled_part
def closed_step(sizes: Sizes, z: Floats, row: int, state: State, A: Floats) -> bool:
    """Equations (1), (3), (6) in one, x = A x + K z; False, and nothing done, as in `settled_block`."""
    n, m, total, x = len(sizes.states), len(sizes.channels), 0.0, stack_vector(sizes.states)
    for i in range(n):
        s = 0.0
        for c in range(m):
            s += state.K[i, c] * z[row, c]
        for j in range(n):
            s += A[i, j] * state.x[j]
        x[i] = s
        total += s * s
    for c in range(m):
        total += z[row, c] * z[row, c]
    if not total <= TAME:
        return False
    for i in range(n):
        state.x[i] = x[i]
    return True


class LiveKernels(NamedTuple):
    """The doors for one size of model, which do not spend time on being told the size."""

    step: Callable[[Floats, float], tuple[float, float]]
    """step(live, reading): take one reading of one channel; return signal and sigma."""
    run: Callable[[Floats, Floats, Floats], None]
    """run(live, readings, out): take (B m,) readings row by row; write signal and sigma to out, (2, B, m)."""


@lru_cache
def live_kernels(states: Size, channels: Size) -> LiveKernels:
    """Make the doors for one size of model."""

    @compiled
    def step(live: Floats, reading: float) -> tuple[float, float]:
        sizes = Sizes(states, channels)
        state, watch, model, held = new_state(sizes), new_watch(sizes), new_step(sizes), new_held(sizes)
        z = stack_matrix(ONE, channels)
        z[0, 0] = reading
        at = load(sizes, live, state, watch, model, held)
        take(sizes, live, at, model, z, 0, state, watch, held)
        transfer(sizes, state, watch, live, SAVE)
        y = 0.0
        for i in range(len(states)):
            y += model.H[0, i] * state.x[i]
        return y, held.sigma[0]

    @compiled
    def run(live: Floats, readings: Floats, out: Floats) -> None:
        sizes = Sizes(states, channels)
        state, watch, model, held = new_state(sizes), new_watch(sizes), new_step(sizes), new_held(sizes)
        z = readings.reshape((len(readings) // len(channels), len(channels)))
        at = load(sizes, live, state, watch, model, held)
        for row in range(len(z)):
            take(sizes, live, at, model, z, row, state, watch, held)
            for c in range(len(channels)):
                y = 0.0
                for i in range(len(states)):
                    y += model.H[c, i] * state.x[i]
                out[0, row, c] = y
                out[1, row, c] = held.sigma[c]
        transfer(sizes, state, watch, live, SAVE)

    return LiveKernels(step, run)
