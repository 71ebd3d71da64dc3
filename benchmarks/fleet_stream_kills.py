"""Kill the processes of a stream over a fleet one after the other, and compare the rows at the end."""

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
from becalm.live.running.learning_buffer import resolution_of
from becalm.live.stream import Stream
from fleet_stream_runs import StreamRun, committed, told_in, write_rows
from live_runs import names_of, readings, recipe_of

CHANNELS, RATE_HZ, FILE_ROWS = 2, 100.0, 150
SENSORS = ("1", "2", "3", "4")
RECIPE, NAMES = recipe_of(CHANNELS, RATE_HZ), tuple(names_of(CHANNELS))
_BEGINS_S = 1.764e9
_PAUSE_S, _LONGEST_S, _PATIENCE_S = 0.7, 3.0, 300.0
_MOST_FILES = 5000
_AMID_WRITING = 0.7  # share of the kills that wait until a file is being written


class Found(NamedTuple):
    """The result at the end."""

    kills: dict[str, int]
    rows: int
    orphans: int  # number of files that killed processes left, and that the log does not list
    says: str

    @property
    def is_same(self) -> bool:
        """Return whether the output is that of an uninterrupted stream."""
        return self.says == _SAME


_SAME = "the same to the bit, every row once, in order"


@dataclass
class GrowingLake:
    """A lake to which a file of each sensor is added again and again."""

    folder: Path
    files: int = 0
    _stop: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        """Make the rows of all files."""
        rows = _MOST_FILES * FILE_ROWS
        self.time_s = np.round((_BEGINS_S + np.arange(rows) / RATE_HZ) * 1e6) / 1e6
        self.values = {sensor: readings(rows, CHANNELS, RATE_HZ, int(sensor)) for sensor in SENSORS}

    @property
    def rows(self) -> int:
        """Return the number of rows of each sensor so far."""
        return self.files * FILE_ROWS

    @contextmanager
    def growing(self) -> Iterator[None]:
        """Add files in a thread, until the block ends."""
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
        """Return the output of an uninterrupted stream for a sensor."""
        stream = Stream(RECIPE, 1 / RATE_HZ, resolution_of(self.time_s[:FIRST_ROWS]))
        return stream.take(Block(NAMES, (), self.time_s[: self.rows], self.values[sensor][: self.rows]))


def killed(folder: Path, kills: int, say: Callable[[str], None] = lambda _: None, seed: int = 7) -> Found:
    """Kill a stream's processes, let it finish all rows, and compare them.

    Parameters
    ----------
    folder : Path
        Empty folder for all files.
    kills : int
        Number of kills: of the Python driver, its JVM, an executor and a Python worker in turn.
    say : callable
        Function that gets the kind of each killed process.
    seed : int
        Seed of the random numbers.

    Raises
    ------
    RuntimeError
        If the stream makes no progress.
    """
    (folder / "r.toml").write_text(RECIPE.to_toml(), encoding="utf-8")
    lake, stream, dice = GrowingLake(folder / "lake"), StreamRun(folder), random.Random(seed)
    try:
        with lake.growing():
            _wait(lambda: lake.files > 0, stream)
            stream.begin()
            for _ in range(kills):
                say(_kill(stream, dice))
        _wait(lambda: _written_rows(stream.output) >= lake.rows * len(SENSORS), stream)
    finally:
        stream.end()
    orphans = len(_uncounted(stream.output))
    return Found(stream.kills, lake.rows * len(SENSORS), orphans, _compare(stream, lake))


def _kill(stream: StreamRun, dice: random.Random) -> str:
    """Kill one process while the stream is working; return its kind."""
    before = len(committed(stream.output))
    _wait(lambda: len(committed(stream.output)) > before, stream)  # the stream is working
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
    """Return the files that the log does not list, or not yet."""
    return set(output.glob("kind=*/*/*.parquet")) - set(committed(output))


def _wait(is_so: Callable[[], bool], stream: StreamRun) -> None:
    """Wait until a condition is true; start the stream again if it ends meanwhile."""
    until = time.monotonic() + _PATIENCE_S
    while not is_so():
        if stream.has_begun and not stream.is_running:
            stream.end()
            stream.begin()
        if time.monotonic() > until:
            raise RuntimeError(f"The stream does not go on: {stream.said()}")
        time.sleep(0.01)


def _written_rows(output: Path) -> int:
    return sum(pq.read_metadata(path).num_rows for path in committed(output) if "kind=readings" in path.parts)


def _compare(stream: StreamRun, lake: GrowingLake) -> str:
    for sensor in SENSORS:
        table, expected = told_in(stream.output, sensor), lake.uninterrupted(sensor)
        if not np.array_equal(_seconds(table), expected.time_s):
            return f"NOT all rows of {sensor} once and in order: {table.num_rows} of {lake.rows}"
        for c, name in enumerate(NAMES):
            for end, values in (("", expected.signal), ("_sigma", expected.sigma)):
                if not np.array_equal(table[name + end].to_numpy(), values[:, c], equal_nan=True):
                    return f"{name}{end} of {sensor} is NOT the same"
    return _SAME


def _seconds(table: pa.Table) -> Floats:
    return np.asarray(table["time"].cast(pa.int64()).to_numpy() / 1e6)
