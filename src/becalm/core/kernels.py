"""Many readings in Numba, forward: the twin of `reference.filter_readings`.

Readings are taken in blocks: with the gain that has settled, or, of one channel, with one that still
moves. Rows are taken one by one around gaps, and where a block cannot be. Blocks begin at rows that are
multiples of their length, so that a record cut there gives the same bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import BLOCK, Floats
from becalm.core.compiling import compiled, compiled_part
from becalm.core.kernel_ahead import combine, copy, fill, new_loop
from becalm.core.kernel_block import (
    Block,
    close_loop,
    is_settled,
    log_det_of,
    new_block,
    run_of,
    settled_block,
    step_of,
)
from becalm.core.kernel_moving import Moving, moves_in_blocks, moving_block, new_moving, score_moving, spread_moving
from becalm.core.kernel_row import advance
from becalm.core.kernel_settling import AGREED, LOAD, SAVE, SETTLED, Watch, new_watch, notice, transfer
from becalm.core.kernel_steps import State, new_state, whiten
from becalm.core.sized import Sizes, across, stack_matrix
from becalm.core.system import Record, Step, System


class Trace(NamedTuple):
    """Where results go; an array of no columns is not wanted."""

    signal: Floats  # (m, N) H x
    sigma: Floats  # (m, N) square root of the diagonal of H P H'
    innovation: Floats  # (m, N) NaN where a channel is missing
    innovation_sigma: Floats  # (m, N) square root of the diagonal of S
    prediction: Floats  # (m, N) of the readings, H F x; NaN where a channel is missing
    mean: Floats  # (n, N)
    cov: Floats  # (n, n, N)


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
def write_belief(sizes: Sizes, trace: Trace, k: int, H: Floats, state: State) -> None:
    """Write what is believed of row k."""
    n = len(sizes.states)
    for c in range(len(sizes.channels)):
        if trace.signal.shape[1]:
            y = 0.0
            for i in range(n):
                y += H[c, i] * state.x[i]
            trace.signal[c, k] = y
        if trace.sigma.shape[1]:
            trace.sigma[c, k] = spread(sizes, H, state.P, c)
    if trace.mean.shape[1]:
        for i in range(n):
            trace.mean[i, k] = state.x[i]
    if trace.cov.shape[2]:
        write_cov(sizes, trace, k, state.P)


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


@compiled_part
def write_block(sizes: Sizes, trace: Trace, row: int, H: Floats, state: State, block: Block) -> None:  # noqa: PLR0913
    """Write a block with a settled gain."""
    for c in range(len(sizes.channels)):
        if trace.sigma.shape[1]:
            fill(across(trace.sigma, c, row, BLOCK), spread(sizes, H, state.P, c))
        if trace.innovation_sigma.shape[1]:
            fill(across(trace.innovation_sigma, c, row, BLOCK), innovation_spread(state, c))
    write_found(sizes, trace, row, H, block)
    if trace.cov.shape[2]:
        for k in range(BLOCK):
            write_cov(sizes, trace, row + k, state.P)


@compiled_part
def write_found(sizes: Sizes, trace: Trace, row: int, H: Floats, block: Block) -> None:
    """Write what depends on the readings of a block."""
    for c in range(len(sizes.channels)):
        if trace.signal.shape[1]:
            combine(sizes.states, H[c], block.x, 1, across(trace.signal, c, row, BLOCK))
        if trace.innovation.shape[1]:
            copy(block.nu[c], 0, across(trace.innovation, c, row, BLOCK))
        if trace.prediction.shape[1]:
            copy(block.p[c], 0, across(trace.prediction, c, row, BLOCK))
    if trace.mean.shape[1]:
        for i in range(len(sizes.states)):
            copy(block.x[i], 1, across(trace.mean, i, row, BLOCK))


@compiled_part
def write_cov(sizes: Sizes, trace: Trace, k: int, P: Floats) -> None:
    """Write the covariance of row k."""
    for i in range(len(sizes.states)):
        for j in range(len(sizes.states)):
            trace.cov[i, j, k] = P[i, j]


@compiled_part
def can_move(sizes: Sizes, record: Record, run: int, row: int, watch: Watch, trace: Trace) -> bool:  # noqa: PLR0913
    """Whether a whole block of few states follows one step; not while its rows are looked at one by one."""
    alike = record.step[run] >= 0 and row + BLOCK <= record.first[run + 1]
    singly = trace.cov.shape[2] > 0 or watch.counters[AGREED] > 0.0
    return bool(moves_in_blocks(sizes) and alike and not singly)


@compiled_part
def write_moving(sizes: Sizes, trace: Trace, row: int, step: Step, block: Block, moving: Moving) -> None:  # noqa: PLR0913
    """Write a block of one channel whose gain still moves."""
    write_found(sizes, trace, row, step.H, block)
    if trace.sigma.shape[1]:
        spread_moving(sizes, step, moving, across(trace.sigma, 0, row, BLOCK))
    if trace.innovation_sigma.shape[1]:
        expected = across(trace.innovation_sigma, 0, row, BLOCK)
        for k in range(BLOCK):
            expected[k] = np.sqrt(moving.S[k])


@compiled_part
def take_row(  # noqa: PLR0913
    sizes: Sizes, system: System, record: Record, run: int, row: int, state: State, watch: Watch, enough: float,
    trace: Trace,
) -> tuple[float, float, int]:  # fmt: skip
    """Filter and write one row; return nu' S^-1 nu, log det S and their dimension (8)."""
    step = record.step[run]
    advance(sizes, step_of(sizes, system, step), step, record.z, row, state, watch, enough)
    write_innovation(sizes, trace, row, record.z[row], state)
    write_belief(sizes, trace, row, step_of(sizes, system, step).H, state)
    return whiten(sizes, state)


@compiled
def forward(  # noqa: PLR0913  (a door for Python: what is read, what moves, what is written)
    sizes: Sizes, system: System, record: Record, begun: int, enough: float, memory: Floats, trace: Trace
) -> tuple[float, float, int, int]:
    """Filter the rows of a record from `begun` on.

    A gain is used again once `enough` has settled, GAIN or COVARIANCE (which covariances need).
    `memory` holds the state before them in row 0, and the state after them when done; further rows,
    one a block, are filled with the state before each block.

    Returns the sums of nu' S^-1 nu and of log det S, the number of readings used, and the first row
    with a settled gain (-1: none).
    """
    state, watch, block = new_state(sizes), new_watch(sizes), new_block(sizes)
    loop, HF, ready = new_loop(sizes.states, sizes.channels), stack_matrix(sizes.channels, sizes.states), False
    transfer(sizes, state, watch, memory[0], LOAD)
    moving, block_log_det, live = new_moving(sizes), 0.0, 0
    squares, log_det, used, settled, run = 0.0, 0.0, 0, -1, 0
    row, count = begun, len(record.z)
    while row < count:
        stop = min((row // BLOCK + 1) * BLOCK, count)
        if len(memory) > 1:
            transfer(sizes, state, watch, memory[1 + row // BLOCK], SAVE)
        run = run_of(record, row, run)
        if stop - row == BLOCK and is_settled(watch, record, run, row, enough):
            if not ready:
                close_loop(sizes, system, record.step[run], state, loop, HF)
                block_log_det, live = log_det_of(sizes, state.D)
                ready = True
            s = settled_block(sizes, record.z, row, state, loop, HF, block)
            if s >= 0.0:
                settled = row if settled < 0 else settled
                write_block(sizes, trace, row, step_of(sizes, system, 0).H, state, block)
                squares, log_det, used, row = squares + s, log_det + BLOCK * block_log_det, used + BLOCK * live, stop
                continue
        ready = False
        if stop - row == BLOCK and can_move(sizes, record, run, row, watch, trace):
            step = step_of(sizes, system, record.step[run])
            if moving_block(sizes, step, record.step[run], record.z, row, state, block, moving):
                notice(sizes, step, record.step[run], state, watch, float(BLOCK))
                write_moving(sizes, trace, row, step, block, moving)
                s, d = score_moving(block, moving)
                squares, log_det, used, row = squares + s, log_det + d, used + BLOCK, stop
                continue
        while row < stop:
            run = run_of(record, row, run)
            s, d, dimension = take_row(sizes, system, record, run, row, state, watch, enough, trace)
            squares, log_det, used = squares + s, log_det + d, used + dimension
            if settled < 0 and watch.counters[SETTLED] >= enough:
                settled = row
            row += 1
    transfer(sizes, state, watch, memory[0], SAVE)
    return squares, log_det, used, settled
