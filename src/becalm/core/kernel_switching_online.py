"""A bank that switches, a reading or a block at a time in Numba, with all that is needed in one array.

The array holds whether a level is kept, whether it is known and what it is, the largest reading and level, then
the beliefs, the bank for a step of 1, and how modes begin: one argument, because every argument costs time.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled, compiled_part, woven
from becalm.core.kernel_online import LiveKernels
from becalm.core.kernel_settling import LOAD, SAVE, transfer_matrix, transfer_vector
from becalm.core.kernel_switching import UNKNOWN, advance_modes, merge
from becalm.core.kernel_switching_row import (
    Bank,
    BankSizes,
    Beliefs,
    Look,
    bank_sizes,
    memory_length,
    new_beliefs,
    new_look,
)
from becalm.core.possible import largest_beside, largest_level

KEEPS_LEVEL, LEVEL_KNOWN, LEVEL, LARGEST, LARGEST_LEVEL, BELIEFS = range(6)


def new_live_bank(bank: Bank, start: Floats, *, keeps_level: bool) -> Floats:
    """Lay a bank for one length of step out, before any reading."""
    parts = [np.ravel(matrix) for matrix in (*bank, start)]
    beliefs = np.zeros(memory_length(bank.H.shape[1], len(bank.R)))
    r = float(bank.R.min())
    return np.concatenate([[float(keeps_level), 0.0, 0.0, largest_beside(r), largest_level(r)], beliefs, *parts])


def live_bank_length(states: int, modes: int) -> int:
    """Return how many numbers a live bank takes."""
    n, M = states, modes
    return BELIEFS + memory_length(n, M) + 2 * M * n * n + M * M + 2 * n + 2 * M + 2 + M * (1 + n)


@woven
def live_bank(sizes: BankSizes, live: Floats) -> tuple[Bank, Floats]:
    """Return the bank and how modes begin, as parts of the array."""
    n, modes, squared = len(sizes.states), len(sizes.modes), len(sizes.squared)
    a = BELIEFS + modes * (1 + n + squared)
    b = a + modes * squared
    c = b + modes * squared
    d = c + modes * modes
    e = d + n
    f = e + n
    g = f + modes
    h = g + modes
    bank = Bank(
        live[a:b].reshape((modes, n, n)),
        live[b:c].reshape((modes, n, n)),
        live[c:d].reshape((1, modes, modes)),
        live[d:e].reshape((1, n)),
        live[e:f].reshape((1, n)),
        live[f:g],
        live[g:h],
        live[h : h + 2],
    )
    return bank, live[h + 2 :].reshape((modes, 1 + n))


@compiled_part
def transfer_live(sizes: BankSizes, now: Beliefs, live: Floats, saving: float) -> None:
    """Save beliefs in the array, or load them."""
    at = transfer_vector(sizes.modes, now.mu, live, BELIEFS, saving)
    at = transfer_matrix(sizes.modes, sizes.states, now.x, live, at, saving)
    transfer_matrix(sizes.modes, sizes.squared, now.P, live, at, saving)


@compiled_part
def take_live(  # noqa: PLR0913
    sizes: BankSizes, live: Floats, bank: Bank, start: Floats, z: float, now: Beliefs, mixed: Beliefs, look: Look
) -> tuple[float, float]:
    """Take one reading; return signal and sigma, NaN and inf where nothing is known yet."""
    z = z if abs(z) <= live[LARGEST] else np.nan
    if live[KEEPS_LEVEL] > 0.0:
        if live[LEVEL_KNOWN] == 0.0 and abs(z) <= live[LARGEST]:
            live[LEVEL_KNOWN], live[LEVEL] = 1.0, z if abs(z) <= live[LARGEST_LEVEL] else 0.0
        z -= live[LEVEL]
    _, became = advance_modes(sizes, bank, z, 0, start, now, mixed, look)
    if became == UNKNOWN:
        return np.nan, np.inf
    y, v = merge(sizes, bank.C, now)
    return y + live[LEVEL], np.sqrt(max(v, 0.0))


@lru_cache
def live_bank_kernels(states: int, modes: int) -> LiveKernels:
    """Make the doors for one size of bank."""
    own, count, squared, each = bank_sizes(states, modes)

    @compiled
    def step(live: Floats, reading: float) -> tuple[float, float]:
        sizes = BankSizes(own, count, squared, each)
        now, mixed, look = new_beliefs(sizes), new_beliefs(sizes), new_look(sizes)
        bank, start = live_bank(sizes, live)
        transfer_live(sizes, now, live, LOAD)
        told = take_live(sizes, live, bank, start, reading, now, mixed, look)
        transfer_live(sizes, now, live, SAVE)
        return told

    @compiled
    def run(live: Floats, readings: Floats, out: Floats) -> None:
        sizes = BankSizes(own, count, squared, each)
        now, mixed, look = new_beliefs(sizes), new_beliefs(sizes), new_look(sizes)
        bank, start = live_bank(sizes, live)
        transfer_live(sizes, now, live, LOAD)
        for row in range(len(readings)):
            out[0, row, 0], out[1, row, 0] = take_live(sizes, live, bank, start, readings[row], now, mixed, look)
        transfer_live(sizes, now, live, SAVE)

    return LiveKernels(step, run)
