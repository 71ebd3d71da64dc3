"""Where the kernels of a fixed lag and of a stream write, and what they write there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part
from becalm.core.kernel_steps import State
from becalm.core.model import Model
from becalm.core.sized import Sizes, size


class Trace(NamedTuple):
    """Where results go; an array of no columns is not wanted."""

    signal: Floats  # (m, N) H x
    sigma: Floats  # (m, N) square root of the diagonal of H P H'
    innovation: Floats  # (m, N) NaN where a channel is missing
    innovation_sigma: Floats  # (m, N) square root of the diagonal of S
    prediction: Floats  # (m, N) of the readings, H F x; NaN where a channel is missing
    mean: Floats  # (n, N)
    cov: Floats  # (n, n, N)


def sizes_of(model: Model) -> Sizes:
    """Return the sizes that kernels are specialised for."""
    return Sizes(size(model.states), size(model.channels))


def new_trace(model: Model, count: int, *, innovations: bool) -> Trace:
    """Make room for the innovations of `count` rows, if they are wanted, and for nothing else."""
    n, m = model.states, model.channels
    nothing = np.empty((m, 0))
    return Trace(
        signal=nothing,
        sigma=nothing,
        innovation=np.empty((m, count if innovations else 0)),
        innovation_sigma=np.empty((m, count if innovations else 0)),
        prediction=nothing,
        mean=np.empty((n, 0)),
        cov=np.empty((n, n, 0)),
    )


@compiled_part
def spread(sizes: Sizes, H: Floats, P: Floats, channel: int) -> float:
    """Return the standard deviation of H x of one channel."""
    v = 0.0
    for i in range(len(sizes.states)):
        for j in range(len(sizes.states)):
            v += H[channel, i] * P[i, j] * H[channel, j]
    return float(np.sqrt(max(v, 0.0)))


@compiled_part
def innovation_spread(state: State, channel: int) -> float:
    """Return the square root of a diagonal element of S = L D L'."""
    s = state.D[channel]
    for b in range(channel):
        s += state.L[channel, b] * state.L[channel, b] * state.D[b]
    return float(np.sqrt(s))


@compiled_part
def write_innovation(sizes: Sizes, trace: Trace, k: int, reading: Floats, state: State) -> None:
    """Write the innovations of row k and what was expected of them; `reading` is (m,)."""
    for c in range(len(sizes.channels)):
        if trace.innovation.shape[1]:
            trace.innovation[c, k] = state.nu[c] if state.seen[c] else np.nan
        if trace.innovation_sigma.shape[1]:
            trace.innovation_sigma[c, k] = innovation_spread(state, c) if state.seen[c] else np.nan
        if trace.prediction.shape[1]:
            trace.prediction[c, k] = reading[c] - state.nu[c] if state.seen[c] else np.nan
