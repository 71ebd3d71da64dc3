"""Blocks and outputs to count, and a clock that a test sets."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from becalm.core.arrays import Codes
from becalm.live.block import Block, Loss, Output
from becalm.live.watching.meter import Meter

NAMES = ("ax", "ay")


class Clock:
    """Tells the seconds that it was set to."""

    def __init__(self, now_s: float = 1000.0) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        return self.now_s


def block_of(rows: int, losses: Iterable[Loss] = ()) -> Block:
    return Block(NAMES, ("g", "g"), np.arange(float(rows)), np.ones((rows, 2)), losses=tuple(losses))


def output_of(verdicts: Codes, arrived_s: float, losses: Iterable[Loss] = ()) -> Output:
    rows = len(verdicts)
    values = np.ones((rows, 2))
    return Output(0, np.arange(float(rows)), values, values, values, verdicts, tuple(losses), arrived_s)


def used(rows: int, arrived_s: float) -> Output:
    return output_of(np.zeros((rows, 2), np.int8), arrived_s)


def metered(names: Sequence[str] = NAMES, clock: Callable[[], float] = time.monotonic) -> Meter:
    """Return a meter of a stream that has begun."""
    meter = Meter("udp:9000", clock=clock)
    meter.begin(names, "")
    return meter
