"""Rivals timed in turn: wall and CPU nanoseconds a sample, and whether what was asked is reached."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

AGREEMENT = 1e-6
"""Largest difference to becalm, over the largest value, at which a rival counts as doing the same."""


@dataclass(frozen=True)
class Asked:
    """What is asked of one row: at least a ratio to becalm, or at most some nanoseconds."""

    text: str
    least_ratio: float = 0.0
    most_ns: float = inf


def at_most(times: float) -> Asked:
    """Ask that becalm takes at most `times` as long as this rival."""
    return Asked(f"becalm <= {times:g} x this", least_ratio=1 / times)


def faster(times: float) -> Asked:
    """Ask that becalm is at least `times` as fast as this rival."""
    return Asked(f"becalm >= {times:g} x faster", least_ratio=times)


def within(nanoseconds: float) -> Asked:
    """Ask that this row takes at most so long a sample."""
    return Asked(f"<= {nanoseconds:g} ns", most_ns=nanoseconds)


@dataclass(frozen=True)
class Rival:
    """One way to do a job.

    Attributes
    ----------
    name : str
        As in the table.
    count : int
        Samples that one call treats.
    run : callable
        Does the job once and returns its results.
    asked : Asked or None
        What is asked of becalm beside it.
    difference : callable or None
        Tells from the results how far they are from becalm's, over the largest value.
    """

    name: str
    count: int
    run: Callable[[], Any]
    asked: Asked | None = None
    difference: Callable[[Any], float] | None = None


_LARGE = 1_000_000  # samples
_TOUCHED = 640 << 20  # bytes; more than any result


@dataclass(frozen=True)
class Row:
    """A row of the table; nanoseconds are medians a sample, the ratio is of wall times to the job's first row."""

    job: str
    rival: str
    count: int
    wall_ns: float
    cpu_ns: float
    ratio: float
    asked: Asked | None
    difference: float | None

    @property
    def agrees(self) -> bool:
        """Whether the results are becalm's, or nobody compared them; NaN is no agreement."""
        return self.difference is None or self.difference <= AGREEMENT

    @property
    def reached(self) -> str:
        """Whether what was asked is reached: "yes", "no", or nothing where nothing was asked."""
        if self.asked is None:
            return ""
        return "yes" if self.ratio >= self.asked.least_ratio and self.wall_ns <= self.asked.most_ns else "**no**"

    def as_markdown(self) -> str:
        """Write one line of the table."""
        same = (
            "" if self.difference is None else f"{self.difference:.0e}" if self.agrees else f"**{self.difference:.0e}**"
        )
        cells = [
            self.job,
            self.rival,
            _written(self.count),
            _written(self.wall_ns),
            _written(self.cpu_ns),
            _written(self.ratio),
            self.asked.text if self.asked else "",
            self.reached,
            same,
        ]
        return f"| {' | '.join(cells)} |"


def _written(number: float) -> str:
    """Write three digits, or all before the point, in groups."""
    return f"{number:,.0f}".replace(",", " ") if number >= 100 else f"{number:.3g}"


def race(job: str, rivals: Sequence[Rival], repeats: int) -> list[Row]:
    """Time each rival `repeats` times, in turn; the first one is becalm.

    The ratio is the median of the ratios of the rounds, so that a machine that becomes slower on
    the way slows both. Freeing the results is not counted, making room for them is.
    """
    differences = [_warm_up(rival) for rival in rivals]
    wall, cpu = np.empty((repeats, len(rivals))), np.empty((repeats, len(rivals)))
    for turn in range(repeats):
        for i in np.roll(np.arange(len(rivals)), turn).tolist():
            wall[turn, i], cpu[turn, i] = _timed(rivals[i])
    ratios = np.median(wall / wall[:, :1], axis=0)
    return [
        Row(job, rival.name, rival.count, float(w), float(c), float(ratio), rival.asked, difference)
        for rival, w, c, ratio, difference in zip(
            rivals, np.median(wall, axis=0), np.median(cpu, axis=0), ratios, differences, strict=True
        )
    ]


def _warm_up(rival: Rival) -> float | None:
    """Run once, so that all is compiled and loaded; return how far the results are from becalm's."""
    results = rival.run()
    return None if rival.difference is None else rival.difference(results)


def _timed(rival: Rival) -> tuple[float, float]:
    """Run once; return the wall-clock and the CPU nanoseconds a sample."""
    gc.collect()
    if rival.count >= _LARGE:
        _touch_memory()
    gc.disable()
    wall, cpu = time.perf_counter(), time.process_time()
    results = rival.run()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    gc.enable()
    del results
    return 1e9 * wall / rival.count, 1e9 * cpu / rival.count


def _touch_memory() -> None:
    """Use some memory and free it: a virtual machine may have given free memory away, and takes long to get it back.

    Every rival then gets fresh pages that the machine has at hand, whoever ran before it.
    """
    np.ones(_TOUCHED // 8)
