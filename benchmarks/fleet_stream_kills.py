"""Kills the processes of a stream over a fleet one after the other, and compares what counts at the end."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from becalm.core.arrays import Floats
from becalm.fleet.stream.plan import FIRST_ROWS
from becalm.live.block import Block, Output
from becalm.live.learning_buffer import resolution_of
from becalm.live.stream import Stream
from fleet_stream_runs import StreamRun, committed, told_in, write_rows
from live_runs import names_of, readings, recipe_of

CHANNELS, RATE_HZ, FILE_ROWS = 2, 100.0, 150
SENSORS = ("1", "2", "3", "4")
RECIPE, NAMES = recipe_of(CHANNELS, RATE_HZ), tuple(names_of(CHANNELS))
_BEGINS_S = 1.764e9
_PAUSE_S, _LONGEST_S, _PATIENCE_S = 0.7, 3.0, 300.0
_MOST_FILES = 5000
_AMID_WRITING = 0.7  # so many kills wait for a file that is being written


class Found(NamedTuple):
    """What was left at the end."""

    kills: dict[str, int]
    rows: int
    orphans: int  # files that a killed process left, and that do not count
    says: str

    @property
    def is_same(self) -> bool:
        """Whether it is what an uninterrupted stream gives."""
        return self.says == _SAME


_SAME = "the same to the bit, every row once, in order"


@dataclass
class GrowingLake:
    """A lake into which a file of every sensor comes, again and again."""

    folder: Path
    files: int = 0
    _stop: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        """Make all that will ever come."""
        rows = _MOST_FILES * FILE_ROWS
        self.time_s = np.round((_BEGINS_S + np.arange(rows) / RATE_HZ) * 1e6) / 1e6
        self.values = {sensor: readings(rows, CHANNELS, RATE_HZ, int(sensor)) for sensor in SENSORS}

    @property
    def rows(self) -> int:
        """How many of each sensor came."""
        return self.files * FILE_ROWS

    @contextmanager
    def growing(self) -> Iterator[None]:
        """Let files come."""
        thread = threading.Thread(target=self._grow, daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._stop.set()
            thread.join()

    def _grow(self) -> None:
        while self.files < _MOST_FILES and not self._stop.wait(_PAUSE_S):
            own = slice(self.rows, self.rows + FILE_ROWS)
            for sensor, values in self.values.items():
                channels = {name: values[own, c] for c, name in enumerate(NAMES)}
                write_rows(self.folder / f"sensor={sensor}" / f"{self.files:05d}.parquet", self.time_s[own], channels)
            self.files += 1

    def uninterrupted(self, sensor: str) -> Output:
        """Return what a stream that nobody killed tells of a sensor."""
        stream = Stream(RECIPE, 1 / RATE_HZ, resolution_of(self.time_s[:FIRST_ROWS]))
        return stream.take(Block(NAMES, (), self.time_s[: self.rows], self.values[sensor][: self.rows]))


def killed(folder: Path, kills: int, say: Callable[[str], None] = lambda _: None, seed: int = 7) -> Found:
    """Kill a stream's processes so often; then let it go on until all is told, and compare.

    Parameters
    ----------
    folder : Path
        Empty, for all of it.
    kills : int
        How often; Python driver, its JVM, executor and Python worker by turns.
    say : callable
        Is told of each kill.
    seed : int
        Of the dice.

    Raises
    ------
    RuntimeError
        If the stream does not go on.
    """
    (folder / "r.toml").write_text(RECIPE.to_toml(), encoding="utf-8")
    lake, stream, dice = GrowingLake(folder / "lake"), StreamRun(folder), random.Random(seed)
    try:
        with lake.growing():
            _wait(lambda: lake.files > 0, stream)
            stream.begin()
            for _ in range(kills):
                say(_kill(stream, dice))
        _wait(lambda: _told_rows(stream.output) >= lake.rows * len(SENSORS), stream)
    finally:
        stream.end()
    orphans = len(_uncounted(stream.output))
    return Found(stream.kills, lake.rows * len(SENSORS), orphans, _compare(stream, lake))


def _kill(stream: StreamRun, dice: random.Random) -> str:
    """Kill one process amid its work; begin again where the driver is gone."""
    before = len(committed(stream.output))
    _wait(lambda: len(committed(stream.output)) > before, stream)  # it is at work
    if dice.random() < _AMID_WRITING:
        left = _uncounted(stream.output)
        _wait(lambda: bool(_uncounted(stream.output) - left), stream)
    else:
        time.sleep(dice.uniform(0, _LONGEST_S))
    kind = None
    while kind is None:
        kind = stream.kill_one(dice)
    return kind


def _uncounted(output: Path) -> set[Path]:
    """Return the files that do not count, or not yet."""
    return set(output.glob("kind=*/*/*.parquet")) - set(committed(output))


def _wait(is_so: Callable[[], bool], stream: StreamRun) -> None:
    """Wait until something is so; begin the stream again where it ended meanwhile."""
    until = time.monotonic() + _PATIENCE_S
    while not is_so():
        if stream.has_begun and not stream.is_running:
            stream.end()
            stream.begin()
        if time.monotonic() > until:
            raise RuntimeError(f"The stream does not go on: {stream.said()}")
        time.sleep(0.01)


def _told_rows(output: Path) -> int:
    return sum(pq.read_metadata(path).num_rows for path in committed(output) if "kind=readings" in path.parts)


def _compare(stream: StreamRun, lake: GrowingLake) -> str:
    for sensor in SENSORS:
        table, expected = told_in(stream.output, sensor), lake.uninterrupted(sensor)
        if not np.array_equal(_seconds(table), expected.time_s):
            return f"NOT all rows of {sensor} once and in order: {table.num_rows} of {lake.rows}"
        for c, name in enumerate(NAMES):
            for end, told in (("", expected.signal), ("_sigma", expected.sigma)):
                if not np.array_equal(table[name + end].to_numpy(), told[:, c], equal_nan=True):
                    return f"{name}{end} of {sensor} is NOT the same"
    return _SAME


def _seconds(table: pa.Table) -> Floats:
    return np.asarray(table["time"].cast(pa.int64()).to_numpy() / 1e6)
