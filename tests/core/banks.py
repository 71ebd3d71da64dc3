"""What tests of banks share: banks, records, and running the filter and the smoother over them."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.imm.modes import InteractingModels, Mode, numbered_steps
from becalm.core.model.components import motion, oscillator
from becalm.native.imm import (
    ImmBuffers,
    ModeMatrices,
    Steps,
    blocks_before,
    filter_rows,
    new_state,
    nothing_later,
    smooth_rows,
)

NONE: Floats = np.empty(0)

DENSITIES = (1e-3, 1e-1, 1.0, 1e-2)
VARIANCES = (1.0, 0.5, 2.0, 30.0)
LASTING = (40.0, 15.0, 25.0, 8.0)
NAMES = ("still", "moving", "quick", "loud")


def bank_of(
    order: int, modes: int, *, share: float = 0.0, rejects: bool = False, alike: bool = False
) -> InteractingModels:
    """Return a bank; the still mode has one state, unless all are alike."""
    own = []
    for j in range(modes):
        part = motion(1 if j == 0 and not alike else order, DENSITIES[0 if alike else j])
        own.append(Mode(NAMES[j], part, VARIANCES[0 if alike else j], LASTING[j], wild_share=share))
    return InteractingModels(tuple(own), wild_variance=400.0 if share else 0.0, rejects=rejects)


def tones(count: int) -> InteractingModels:
    """Return a bank whose moving mode has tones beside its motion."""
    moving = motion(1, 0.01)
    for k in range(count):
        moving = moving + oscillator(0.05 * (k + 1), 1e-3, 1e-3)
    return InteractingModels((Mode("still", motion(1, 1e-6), 1.0, 20.0), Mode("moving", moving, 1.0, 50.0)))


def record(rows: int, kind: str = "even") -> tuple[Floats, Floats]:
    """Return readings that rest, wander and jump, and the steps before them."""
    rng = np.random.default_rng(rows)
    moves = np.sin(np.arange(rows) / 15 * np.pi) > 0
    z = np.cumsum(np.where(moves, 0.7, 0.01) * rng.normal(size=rows)) + rng.normal(size=rows)
    z[rows // 2 :] += 8.0
    elapsed = np.ones(rows)
    if kind == "holes":
        z[rng.random(rows) < 0.1], z[:3], z[rows // 3 : rows // 3 + 12] = np.nan, np.nan, np.inf
    elif kind == "uneven":
        elapsed = rng.choice([0.25, 1.0, 1.5, 7.0], rows)
    elif kind == "repeats":
        elapsed[rng.random(rows) < 0.2] = 0.0
    elif kind == "wild":
        wild = rng.random(rows) < 0.05
        z[wild] += 20 * rng.normal(size=int(wild.sum()))
    return z, elapsed


def laid_out(switching: InteractingModels, elapsed: Floats) -> tuple[ModeMatrices, Steps]:
    """Return the bank and the steps as they take them."""
    lengths, steps = numbered_steps(elapsed)
    return switching.matrices(lengths), steps


def new_trace(switching: InteractingModels, rows: int) -> ImmBuffers:
    nan = [np.full(rows, np.nan) for _ in range(5)]
    modes = np.full((len(switching.modes), rows), np.nan)
    return ImmBuffers(nan[0], nan[1], nan[2], nan[3], modes, nan[4], np.full((switching.states, rows), np.nan))


def kernels(switching: InteractingModels, z: Floats, elapsed: Floats) -> tuple[ImmBuffers, ImmBuffers, float]:
    """Filter and smooth; return what is written of each, and the log-likelihood."""
    bank, steps = laid_out(switching, elapsed)
    state, before = new_state(bank, keeps_level=False), blocks_before(bank, len(z))
    forward, back = new_trace(switching, len(z)), new_trace(switching, len(z))
    total = filter_rows(bank, state, z, steps, forward, before=before)
    smooth_rows(bank, state, z, steps, before, nothing_later(bank), back)
    assert filter_rows(bank, new_state(bank, keeps_level=False), z, steps) == total
    return forward, back, total
