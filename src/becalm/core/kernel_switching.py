"""A bank that switches, forward over readings: what is written of each row, and the door for Python."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import BLOCK, Floats, Integers
from becalm.core.compiling import compiled, compiled_part
from becalm.core.kernel_settling import LOAD, SAVE
from becalm.core.kernel_steps import LARGEST_READING
from becalm.core.kernel_switching_row import (
    TOLD,
    Bank,
    BankSizes,
    Beliefs,
    Look,
    begin_modes,
    foresee,
    memory_length,
    new_beliefs,
    new_look,
    step_modes,
    take_modes,
    transfer_beliefs,
)
from becalm.core.kernel_switching_score import score_of_modes

UNKNOWN, BEGUN, MISSED, JUDGED = 0, 1, 2, 3  # what became of a row: before the first reading, that one, none, one
_TINIEST = 1e-300  # a weight below it has lost its digits


class SwitchingTrace(NamedTuple):
    """What is written of each row; an array of no columns is not wanted."""

    signal: Floats  # (N,)
    sigma: Floats  # (N,)
    innovation: Floats  # (N,) of the mixture: the normal score of the reading times innovation_sigma
    innovation_sigma: Floats  # (N,)
    probability: Floats  # (M, N) of each mode
    wild: Floats  # (N,) probability that the reading is wild
    mean: Floats  # (n, N) of the mixture


_NONE: Floats = np.empty(0)
NOTHING_WANTED = SwitchingTrace(_NONE, _NONE, _NONE, _NONE, np.empty((0, 0)), _NONE, np.empty((0, 0)))


def note_length(states: int, modes: int) -> int:
    """Return how many numbers hold all beliefs after a row, and what its reading said."""
    return memory_length(states, modes) + TOLD * modes


@compiled_part
def advance_modes(  # noqa: PLR0913
    sizes: BankSizes, bank: Bank, z: float, s: int, start: Floats, now: Beliefs, mixed: Beliefs, look: Look
) -> tuple[float, int]:
    """Take a row, step s after the one before (-1: none); return its log-likelihood and what became of it."""
    arrived = abs(z) <= LARGEST_READING
    if not now.mu[0] > 0.0:
        if arrived:
            begin_modes(sizes, z, start, now)
        return 0.0, BEGUN if arrived else UNKNOWN
    if s >= 0:
        step_modes(sizes, bank, s, now, mixed)
    else:
        for j in range(len(sizes.modes)):
            mixed.mu[j] = now.mu[j]
    if arrived:
        foresee(sizes, bank, now, look)
        return take_modes(sizes, bank, z, look, mixed, now), JUDGED
    for j in range(len(sizes.modes)):
        now.mu[j] = mixed.mu[j]
    return 0.0, MISSED


@compiled_part
def merge(sizes: BankSizes, row: Floats, now: Beliefs) -> tuple[float, float]:
    """Return mean and variance of row x, (1, n) times the state, over all modes."""
    n, y, v = len(sizes.states), 0.0, 0.0
    for j in range(len(sizes.modes)):
        for a in range(n):
            y += now.mu[j] * row[0, a] * now.x[j, a]
    for j in range(len(sizes.modes)):
        own, s = 0.0, 0.0
        for a in range(n):
            own += row[0, a] * now.x[j, a]
            for b in range(n):
                s += row[0, a] * row[0, b] * now.P[j, a * n + b]
        v += now.mu[j] * (s + (own - y) * (own - y))
    return y, v


@compiled_part
def write_modes(sizes: BankSizes, bank: Bank, k: int, now: Beliefs, trace: SwitchingTrace) -> None:
    """Write what is believed after row k."""
    y, v = merge(sizes, bank.C, now)
    if len(trace.signal):
        trace.signal[k], trace.sigma[k] = y, np.sqrt(max(v, 0.0))
    for j in range(trace.probability.shape[0]):
        trace.probability[j, k] = now.mu[j]
    for a in range(trace.mean.shape[0]):
        s = 0.0
        for j in range(len(sizes.modes)):
            s += now.mu[j] * now.x[j, a]
        trace.mean[a, k] = s


@compiled_part
def write_innovation_of_modes(  # noqa: PLR0913
    sizes: BankSizes, bank: Bank, z: float, k: int, look: Look, mixed: Beliefs, trace: SwitchingTrace
) -> None:
    """Write the innovation of the mixture at row k, and what was expected of it."""
    if not len(trace.innovation):
        return
    y, v = 0.0, 0.0
    for j in range(len(sizes.modes)):
        y += mixed.mu[j] * look.Hx[j]
    for j in range(len(sizes.modes)):
        v += mixed.mu[j] * (look.S[j] + (look.Hx[j] - y) ** 2)
    sigma = np.sqrt(v)
    trace.innovation[k], trace.innovation_sigma[k] = sigma * score_of_modes(sizes, bank, z, look, mixed), sigma


@compiled_part
def write_wild(sizes: BankSizes, k: int, look: Look, now: Beliefs, trace: SwitchingTrace) -> None:
    """Write how probable it is that the reading of row k is wild."""
    if len(trace.wild):
        s = 0.0
        for j in range(len(sizes.modes)):
            s += now.mu[j] * look.wild[j]
        trace.wild[k] = s


@compiled_part
def note_reading(sizes: BankSizes, bank: Bank, z: float, look: Look, now: Beliefs, note: Floats) -> None:  # noqa: PLR0913
    """Note behind the beliefs what a reading said to each mode: exp(g + p H d - W (H d)^2 / 2), d from its mean.

    W is w / R, p is W (z - H x) with x after the reading, and g is such that the whole is as likely, to what the
    mode expected, as it was weighed: w < 1 is the share of a reading that may be wild.
    """
    n, at = len(sizes.states), len(note) - TOLD * len(sizes.modes)
    for j in range(len(sizes.modes)):
        y, R = z, bank.R[j]
        for a in range(n):
            y -= bank.H[0, a] * now.x[j, a]
        W, s, nu = (1.0 - look.wild[j] * bank.wild[1]) / R, look.S[j] - R, z - look.Hx[j]
        weight = np.log(look.weight[j]) if look.weight[j] > _TINIEST else look.far[j]
        own = weight + 0.5 * np.log(1.0 + W * s)
        note[at], note[at + 1] = W * y, W
        note[at + 2] = own + 0.5 * (W * nu * nu / (1.0 + W * s) - W * y * y)
        at += TOLD


@compiled
def switch_forward(  # noqa: PLR0913  (a door for Python: what is read, what moves, what is written)
    sizes: BankSizes, bank: Bank, z: Floats, steps: Integers, start: Floats, memory: Floats, trace: SwitchingTrace
) -> tuple[float, int]:
    """Filter readings (N,), NaN where missing; `steps` (N,) says which step precedes each, -1 for none.

    `memory` holds the beliefs before them in row 0 (a first probability of 0: nothing was read yet), and the
    beliefs after them when done; further rows are filled with the beliefs before each block of 256 rows, or,
    where they have room for it (`note_length`), after each row, with what its reading said.

    Returns the log-likelihood of all readings but the first, and how many they are.
    """
    now, mixed, look = new_beliefs(sizes), new_beliefs(sizes), new_look(sizes)
    transfer_beliefs(sizes, now, memory[0], LOAD)
    every = memory.shape[1] > len(sizes.modes) * (1 + len(sizes.states) + len(sizes.squared))
    log_likelihood, used = 0.0, 0
    for k in range(len(z)):
        if not every and k % BLOCK == 0 and len(memory) > 1:
            transfer_beliefs(sizes, now, memory[1 + k // BLOCK], SAVE)
        likelihood, became = advance_modes(sizes, bank, z[k], steps[k], start, now, mixed, look)
        if became == JUDGED:
            log_likelihood += likelihood
            used += 1
            write_innovation_of_modes(sizes, bank, z[k], k, look, mixed, trace)
            write_wild(sizes, k, look, now, trace)
        if became != UNKNOWN:
            write_modes(sizes, bank, k, now, trace)
        if every:
            transfer_beliefs(sizes, now, memory[1 + k], SAVE)
            if became == JUDGED:
                note_reading(sizes, bank, z[k], look, now, memory[1 + k])
    transfer_beliefs(sizes, now, memory[0], SAVE)
    return log_likelihood, used
