"""Stamps of a stream, one after the other: how many steps passed before each, and which cannot be taken."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Booleans, Codes, Floats
from becalm.core.compiling import compiled, compiled_part

GRID, LAST, STARTED, STEP, SLACK, FARTHEST, PACE, HELD, HELD_LAST, OPENED, COARSE = range(11)
"""What the state holds: where the even grid stands, the last stamp (s), whether there was one, the step (s), how far
off the grid a stamp may lie (steps), the longest gap that one stamp is believed (s), steps of the sender's clock in one
of ours, stamps held back in a row, the last of them (s), whether the source was opened anew since, whether rows may
share a stamp."""

WORDS = 11

TAKEN, LATE, REPEATED, FAR, RESET, UNTIMED = range(6)
"""What became of a row: taken; before or at the row before; far ahead; taken, though the clock jumped; no stamp."""

AGREEING = 8
"""Stamps in a row, behind or far ahead of the clock, that ascend: then it is the clock that jumped."""

_PULL, _PULL_PACE = 0.75, 0.1
_HALF = 0.5
_LEAST_PACE, _GREATEST_PACE = 0.98, 1.02


@compiled
def walk_stamps(state: Floats, stamps: Floats, doubled: Booleans, elapsed: Floats, codes: Codes) -> None:
    """Fill in the steps before each row (0 of the first) and what becomes of it; row by row, so that no cut matters."""
    for k in range(len(stamps)):
        t = stamps[k]
        passed = t - state[LAST]
        elapsed[k] = 0.0
        if not np.isfinite(t):
            codes[k] = UNTIMED
        elif state[STARTED] == 0.0:
            codes[k] = TAKEN
            state[STARTED] = 1.0
            state[GRID] = state[LAST] = t
        elif passed < 0.0 or (passed > state[FARTHEST] and state[OPENED] == 0.0):
            codes[k] = hold_back(state, t, elapsed, k)
        else:
            codes[k] = count_steps(state, t, doubled[k], elapsed, k)


@compiled_part
def hold_back(state: Floats, t: float, elapsed: Floats, k: int) -> int:
    """Hold a stamp back that cannot be, until so many agree that it is the clock that jumped."""
    passed = t - state[LAST]
    agrees = state[HELD] > 0.0 and 0.0 < t - state[HELD_LAST] <= state[FARTHEST]
    state[HELD] = state[HELD] + 1.0 if agrees else 1.0
    state[HELD_LAST] = t
    if state[HELD] < AGREEING:
        return LATE if passed < 0.0 else FAR
    elapsed[k] = 1.0 if passed < 0.0 else passed / state[STEP]
    state[GRID] = state[LAST] = t
    state[PACE] = 1.0
    state[HELD] = state[OPENED] = 0.0
    return RESET


@compiled_part
def count_steps(state: Floats, t: float, doubled: bool, elapsed: Floats, k: int) -> int:
    """Count the steps to a stamp that is not before the last: whole ones where it lies on the grid."""
    step = state[STEP]
    steps = (t - state[GRID]) / step
    off = steps - state[PACE]
    whole = np.floor(steps / state[PACE] + 0.5)
    if t == state[LAST] and (doubled or state[COARSE] == 0.0):
        return REPEATED
    if abs(off) <= state[SLACK]:
        elapsed[k] = 1.0
        state[GRID] += step * (state[PACE] + _PULL * off)
        state[PACE] = min(max(state[PACE] + _PULL_PACE * off, _LEAST_PACE), _GREATEST_PACE)
    elif t == state[LAST]:
        elapsed[k] = 1.0
    else:
        on_grid = whole >= 1.0 and abs(steps / state[PACE] - whole) <= state[SLACK] < _HALF
        elapsed[k] = whole if on_grid else (t - state[LAST]) / step
        state[GRID] = t
    state[LAST] = t
    state[HELD] = state[OPENED] = 0.0
    return TAKEN
