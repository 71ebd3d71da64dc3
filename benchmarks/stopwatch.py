"""The processor's time of one row, for the benchmarks that compare filters of this project with each other."""

from __future__ import annotations

import time
from collections.abc import Callable

import becalm

RUNS = 5


def nanoseconds(use: Callable[[], object], rows: int) -> float:
    """Return the processor's time of one row, the shortest of several runs after one that compiles."""
    use()
    took = []
    for _ in range(RUNS):
        begun = time.process_time_ns()
        use()
        took.append(time.process_time_ns() - begun)
    return min(took) / rows


def step_through(online: becalm.Online, z: list[float]) -> None:
    """Take readings one by one."""
    for reading in z:
        online.step(reading)
