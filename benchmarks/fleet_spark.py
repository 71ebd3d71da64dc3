"""Run jobs over a lake on Spark for benchmarks, each in new processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Environment of processes whose libraries must not start threads."""


class Ran(NamedTuple):
    """The time of a job, the number of sensors by state, and the seams of the first sensor."""

    seconds: float
    states: dict[str, int]
    seams: str = ""


PROGRAM = """
import json, os, shutil, sys, time
from pathlib import Path
from becalm.fleet import BatchOptions, clean, open_book, session
from fleet_stream_runs import below
master, lake, recipe, out, stretch, core, rounds = sys.argv[1:]
if core: os.sched_setaffinity(0, {int(core)})
settings = {"spark.executor.memory": "1g"}
with session(master, settings, schedules=True) as spark:
    spark.range(8).mapInArrow(lambda batches: batches, "id long").collect()  # its workers are there now
    every = below(os.getpid())[1:]
    for number, executor in enumerate(one for one in every if "CoarseGrainedExecutorBackend" in one.command):
        for process in below(executor.pid):
            for thread in os.listdir(f"/proc/{process.pid}/task"):
                os.sched_setaffinity(int(thread), {number})
    for _ in range(int(rounds)):
        shutil.rmtree(out, ignore_errors=True)
        start = time.perf_counter()
        fleet = clean(spark, Path(lake), Path(out), open_book(Path(recipe)), BatchOptions(stretch_rows=int(stretch)))
        took = time.perf_counter() - start
    states = [one.state for one in fleet.outcomes]
    print(json.dumps([took, {one: states.count(one) for one in states}, fleet.outcomes[0].seams]))
"""


class Places(NamedTuple):
    """The paths of a lake, its recipe and the output."""

    lake: Path
    recipe: Path
    out: Path


def on_spark(master: str, places: Places, *, stretch: int = 1 << 40, core: str = "", rounds: int = 2) -> Ran:
    """Clean a lake on Spark in new processes, `rounds` times; return the last result.

    With `core`, all processes are pinned to this core; otherwise each executor of a cluster is pinned to its own core.
    """
    words = [master, *map(str, places), str(stretch), core, str(rounds)]
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": str(Path(__file__).parent)}
    ran = subprocess.run([sys.executable, "-c", PROGRAM, *words], capture_output=True, text=True, env=environment)
    if ran.returncode:
        raise SystemExit(ran.stderr[-2000:])
    return Ran(*json.loads(ran.stdout.splitlines()[-1]))
