"""What a filter with several modes costs per reading, filtered and smoothed, compared with a fixed filter.

Processor time, the shortest of several runs; 200 000 readings of a signal that rests and moves in turn.

Run: python benchmarks/switching_speed.py [-o docs/switching-speed.md]
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

import becalm
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels, Mode
from becalm.core.model.components import motion
from pages import page_parser, publish
from stopwatch import nanoseconds, step_through

Floats = NDArray[np.float64]

ROWS, STEPPED = 200_000, 2000
SIZES = [(states, modes) for states in (1, 2, 3) for modes in (1, 2, 3, 4)]
DENSITIES, NAMES = (1e-6, 1e-3, 1e-1, 1e1), ("still", "gentle", "quick", "abrupt")


def bank(states: int, modes: int) -> InteractingModels:
    """Return interacting models of one order, from still to abrupt."""
    return InteractingModels(tuple(Mode(NAMES[j], motion(states, DENSITIES[j]), 1.0, 100.0) for j in range(modes)))


def readings() -> Floats:
    """Return readings of a signal that rests and moves in turn."""
    rng, moves = np.random.default_rng(1), np.sin(np.arange(ROWS) / 200) > 0
    z: Floats = np.cumsum(np.where(moves, 0.5, 0.001) * rng.normal(size=ROWS)) + rng.normal(size=ROWS)
    return z


def flow(switching: InteractingModels, z: Floats, *, causal: bool) -> object:
    """Filter or smooth a whole record."""
    made = ImmFlow(switching, causal=causal)
    return made.push(z, np.ones(len(z))), made.finish()


def row(states: int, modes: int, z: Floats) -> str:
    """Return the times of one size, and their ratios to those of the fixed filter and smoother."""
    switching, model = bank(states, modes), motion(states, 0.1).to_model(1.0, 1.0)
    fixed = [nanoseconds(partial(run, model, z), ROWS) for run in (kalman_filter, kalman_smoother)]
    own = [nanoseconds(partial(flow, switching, z, causal=causal), ROWS) for causal in (True, False)]
    online = becalm.Online(switching)
    block = nanoseconds(partial(online.run, z), ROWS)
    single = nanoseconds(partial(step_through, online, z[:STEPPED].tolist()), STEPPED)
    cells = [f"{time:.0f} ({time / other:.0f})" for time, other in zip(own, fixed, strict=True)]
    return f"| {states} | {modes} | {cells[0]} | {cells[1]} | {block:.0f} | {single:.0f} |"


def main() -> None:
    """Print the table; with -o, write it as a page."""
    output, z = page_parser(__doc__).parse_args().output, readings()
    lines = [
        "Nanoseconds a reading; in brackets, how many times that of the fixed filter or smoother of the same order.",
        "",
        "| states | modes | filter | smoother | live, a block | live, one by one |",
        "|---|---|---|---|---|---|",
        *(row(states, modes, z) for states, modes in SIZES),
    ]
    publish("The speed of a bank that switches", __doc__, "\n".join(lines) + "\n", output)


if __name__ == "__main__":
    main()
