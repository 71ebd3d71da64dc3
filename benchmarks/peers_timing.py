"""Time rivals in turn, in wall-clock and CPU nanoseconds a sample, and check the requirements."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

AGREEMENT = 1e-6
"""Largest difference from becalm, relative to the largest value, at which a rival counts as doing the same job."""


@dataclass(frozen=True)
class Asked:
    """The requirement of one row: a least ratio to becalm, or a largest time in nanoseconds."""

    text: str
    least_ratio: float = 0.0
    most_ns: float = inf


def at_most(times: float) -> Asked:
    """Require that becalm takes at most `times` as long as this rival."""
    return Asked(f"becalm <= {times:g} x this", least_ratio=1 / times)


def faster(times: float) -> Asked:
    """Require that becalm is at least `times` as fast as this rival."""
    return Asked(f"becalm >= {times:g} x faster", least_ratio=times)


def within(nanoseconds: float) -> Asked:
    """Require that this row takes at most this time for a sample."""
    return Asked(f"<= {nanoseconds:g} ns", most_ns=nanoseconds)


@dataclass(frozen=True)
class Rival:
    """One way to do a job.

    Attributes
    ----------
    name : str
        Name in the table.
    count : int
        Number of samples that one call processes.
    run : callable
        Function that does the job once, and returns its results.
    asked : Asked or None
        Requirement for becalm relative to this rival.
    difference : callable or None
        Function that returns the difference of the results from becalm's, relative to the largest value.
    """

    name: str
    count: int
    run: Callable[[], Any]
    asked: Asked | None = None
    difference: Callable[[Any], float] | None = None


_LARGE = 1_000_000  # number of samples from which memory is touched before a run
_TOUCHED = 640 << 20  # bytes that are touched; more than any result has


@dataclass(frozen=True)
class Row:
    """A row of the table: median nanoseconds per sample, and the ratio of wall-clock times to the job's first row."""

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
        """Return whether the results agree with becalm's or are not compared; NaN does not agree."""
        return self.difference is None or self.difference <= AGREEMENT

    @property
    def reached(self) -> str:
        """Return whether the requirement is reached, "yes" or "no"; "" without a requirement."""
        if self.asked is None:
            return ""
        return "yes" if self.ratio >= self.asked.least_ratio and self.wall_ns <= self.asked.most_ns else "**no**"

    def as_markdown(self) -> str:
        """Return one line of the table."""
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
    """Return a number with three digits, or rounded to an integer with grouped digits."""
    return f"{number:,.0f}".replace(",", " ") if number >= 100 else f"{number:.3g}"


def race(job: str, rivals: Sequence[Rival], repeats: int) -> list[Row]:
    """Time each rival `repeats` times, in turn; the first one is becalm.

    The ratio is the median of the ratios in each turn, so that a machine that becomes slower affects both times. The
    times include allocating the results, but not freeing them.
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
    """Run once, to compile and load everything; return the difference of the results from becalm's."""
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
    """Use some memory and free it: a virtual machine may have returned free memory to its host, and regains it slowly.

    Every rival then gets pages that the machine has already, whatever ran before.
    """
    np.ones(_TOUCHED // 8)
