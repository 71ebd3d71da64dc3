"""Measure the processor time of one row, for benchmarks that compare filters of this project."""

from __future__ import annotations

import time
from collections.abc import Callable

import becalm

RUNS = 5


def nanoseconds(use: Callable[[], object], rows: int) -> float:
    """Return the processor time of one row in nanoseconds, the shortest of several runs after a first one."""
    use()
    took = []
    for _ in range(RUNS):
        begun = time.process_time_ns()
        use()
        took.append(time.process_time_ns() - begun)
    return min(took) / rows


def step_through(online: becalm.Online, z: list[float]) -> None:
    """Filter readings one by one."""
    for reading in z:
        online.step(reading)
