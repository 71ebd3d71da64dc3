"""Write files of a lake, run a stream over them in subprocesses, and read its output, for a benchmark and tests.

This program runs the stream: python benchmarks/fleet_stream_runs.py LAKE OUTPUT RECIPE MASTER EVERY_S PARTITIONS
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from becalm.core.arrays import Floats
from becalm.fleet.stream import LiveBook, SensorPlan, StreamPlan

STAMPS = pa.timestamp("us", "UTC")
KINDS = ("Python driver", "driver's JVM", "executor", "Python worker")
_SETTINGS = {"spark.task.maxFailures": "8", "spark.sql.files.openCostInBytes": "0"}


def write_rows(
    place: Path, time_s: Floats, channels: dict[str, Floats], stamps: pa.DataType = STAMPS, block: int = 0
) -> None:
    """Write rows as a Parquet file that appears complete; with `block`, each of its rows has arrays of that length."""
    time = pa.array(np.round(time_s * 1e6).astype(np.int64)).cast(pa.timestamp("us")).cast(stamps)
    columns = {"time": time} | {name: pa.array(values) for name, values in channels.items()}
    if block:
        edges = [*range(0, len(time), block), len(time)]
        columns = {name: pa.ListArray.from_arrays(edges, column) for name, column in columns.items()}
    place.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), place.with_name(f".{place.name}"))
    place.with_name(f".{place.name}").rename(place)


def committed(output: Path) -> list[Path]:
    """List the files that the log of a stream's output contains, in the order of the log."""
    folder = output / "_spark_metadata"
    logs = [path for path in folder.iterdir() if not path.name.startswith(".")] if folder.exists() else []
    found: dict[str, None] = {}
    for log in sorted(logs, key=lambda path: (int(path.stem), path.suffix)):
        found |= dict.fromkeys(json.loads(line)["path"] for line in log.read_text().splitlines()[1:])
    return [Path(unquote(urlsplit(uri).path)) for uri in found]


def told_in(output: Path, sensor: str, kind: str = "readings") -> pa.Table:
    """Return the output of a stream for a sensor, in the order of the log."""
    folder = output / f"kind={kind}" / f"sensor={sensor}"
    tables = [pq.read_table(path, partitioning=None) for path in committed(output) if path.parent == folder]
    return pa.concat_tables(tables) if tables else pa.table({})


class Process(NamedTuple):
    """A process of a stream."""

    pid: int
    parent: int
    command: str


def below(root: int) -> list[Process]:
    """List a process and its descendants."""
    found = {process.pid: process for process in map(_process, _numbers()) if process is not None}
    listed, wanted = list[Process](), {root}
    for process in sorted(found.values()):  # parents come first, unless the system has wrapped its process ids
        if process.pid in wanted or process.parent in wanted:
            wanted.add(process.pid)
            listed.append(process)
    return listed


def _numbers() -> list[int]:
    return [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]


def _process(pid: int) -> Process | None:
    with contextlib.suppress(OSError, ValueError, IndexError):
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        command = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode("utf-8", "replace")
        return Process(pid, int(fields[1]), command)
    return None


@dataclass
class StreamRun:
    """A stream in subprocesses, which can be killed and started again.

    Attributes
    ----------
    folder : Path
        Folder with `lake`, `out` and `r.toml`.
    master : str
        Master URL of Spark.
    every_s : float
        Time between the starts of micro-batches, in seconds.
    """

    folder: Path
    master: str = "local-cluster[2,1,1024]"
    every_s: float = 1.0
    kills: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    _process: subprocess.Popen[bytes] | None = None
    _known: dict[int, Process] = field(default_factory=dict)

    @property
    def output(self) -> Path:
        """Return the folder of the output."""
        return self.folder / "out"

    def begin(self) -> None:
        """Start the stream, or resume it."""
        words = [self.folder / "lake", self.output, self.folder / "r.toml", self.master, self.every_s, 2]
        with (self.folder / "stderr.txt").open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, __file__, *map(str, words)], cwd=self.folder, stdout=log, stderr=log
            )

    @property
    def has_begun(self) -> bool:
        """Return whether the stream was started, and not ended by `end`."""
        return self._process is not None

    @property
    def is_running(self) -> bool:
        """Return whether the driver is running."""
        return self._process is not None and self._process.poll() is None

    def kill_one(self, dice: random.Random) -> str | None:
        """Kill a process of the stream; return its kind, or None until there is a process of each kind."""
        kinds: dict[str, list[Process]] = {}
        for process in self._processes():
            kinds.setdefault(_kind(process, self._process.pid if self._process else 0), []).append(process)
        there = [kind for kind in KINDS if kind in kinds]
        if len(there) < len(KINDS):
            return None
        kind = min(there, key=lambda one: (self.kills[one], dice.random()))
        os.kill(dice.choice(kinds[kind]).pid, signal.SIGKILL)
        self.kills[kind] += 1
        return kind

    def end(self) -> None:
        """Kill all processes of the stream."""
        for process in self._processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL)
        if self._process is not None:
            self._process.wait()
        while any(_is_still(process) for process in self._known.values()):
            time.sleep(0.05)
        self._process, self._known = None, {}

    def said(self) -> str:
        """Return the end of the output of its processes."""
        return (self.folder / "stderr.txt").read_text(encoding="utf-8", errors="replace")[-4000:]

    def _processes(self) -> list[Process]:
        """List the running processes of the stream, including those whose parents have ended."""
        roots = [*([self._process.pid] if self._process else []), *self._known]
        now = {process.pid: process for root in roots for process in below(root)}
        self._known |= now
        self._known = {pid: process for pid, process in self._known.items() if _is_still(process)}
        return list(self._known.values())


def _is_still(process: Process) -> bool:
    now = _process(process.pid)
    return now is not None and now.command == process.command and bool(now.command)


def _kind(process: Process, root: int) -> str:
    if process.pid == root:
        return KINDS[0]
    if "CoarseGrainedExecutorBackend" in process.command:
        return KINDS[2]
    if "SparkSubmit" in process.command:
        return KINDS[1]
    return KINDS[3] if "pyspark.daemon" in process.command else ""


def main() -> None:
    """Run a stream until it is killed."""
    from becalm.fleet.session import session
    from becalm.fleet.stream import run

    lake, output, recipe, master, every_s, partitions = sys.argv[1:]
    plan = StreamPlan(
        lake, output, SensorPlan(LiveBook(Path(recipe))), every_s=float(every_s), partitions=int(partitions)
    )
    with session(master, _SETTINGS) as spark:
        run(spark, plan).awaitTermination()


if __name__ == "__main__":
    main()
