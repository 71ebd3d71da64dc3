"""A lake on Spark beside one plain process, and an endless sensor that is cut in time.

The lake has 200 sensors of 200 000 rows (two files each, not in the order of time; some with missing stretches and a
gap), a time in seconds and one channel of a random walk in white noise, float64, snappy; the recipe is causal and was
tuned on one of them. *Plain* is one process, pinned to one core, that cleans one sensor after the other by the very
function that a task of Spark runs. Spark's start, and the first task of each worker, which loads becalm, are left out:
a job over another output went before. *A core* is Spark with one executor, pinned to the same core. Turns alternate;
medians are told. Every row of what both made last is compared.

The endless sensor has four files, missing stretches and a gap. As a whole it is one task; cut in time, stretches of
8 388 608 rows. Every row of both outputs is compared, of a causal filter by its bits, of a smoother by how far apart
they are beside the largest number. Spark has started then, and its workers have not.

Memory is the most that any Python worker held (VmHWM), for a tenth of the rows and for all of them.

The model at the end is arithmetic on what was measured here.

Run: python benchmarks/fleet_batch.py [--sensors 200] [--rows 100000000] [--repeats 3] [-o docs/fleet-batch.md]
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import NamedTuple

from becalm.fleet import open_book
from becalm.fleet.job import Job, Sensor
from becalm.fleet.lake import places_in
from becalm.fleet.whole import clean_whole
from fleet_comparing import compared
from fleet_lakes import EACH, RATE_HZ, make_endless, make_lake
from pages import page_parser, publish

PINNED = 0  # the core
LEAST_SHARE, LEAST_SCALING = 0.9, 1.7
"""What was asked."""

YEAR_S, FLEET, CORES = 365.25 * 86_400, 1000, 100
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


class Ran(NamedTuple):
    """What a job took."""

    seconds: float
    states: dict[str, int]
    seams: str = ""


def plain(lake: Path, recipe: Path, out: Path) -> Ran:
    """Clean a lake in this process, one sensor after the other."""
    shutil.rmtree(out, ignore_errors=True)
    book = open_book(recipe)
    sensors = [Sensor(place.name, place.bytes, str(book.hash_for(place.name))) for place in places_in(lake)]
    job = Job(str(lake), str(out), book.by_hash)
    start = time.perf_counter()
    states = [clean_whole(job, sensor).state for sensor in sensors]
    return Ran(time.perf_counter() - start, {state: states.count(state) for state in states})


PROGRAM = """
import json, os, shutil, sys, time
from pathlib import Path
from becalm.fleet import Asked, clean, open_book, session
master, lake, recipe, out, stretch, core, rounds = sys.argv[1:]
if core: os.sched_setaffinity(0, {int(core)})
settings = {"spark.executor.memory": "1g"}
with session(master, settings) as spark:
    for _ in range(int(rounds)):
        shutil.rmtree(out, ignore_errors=True)
        start = time.perf_counter()
        fleet = clean(spark, Path(lake), Path(out), open_book(Path(recipe)), Asked(stretch_rows=int(stretch)))
        took = time.perf_counter() - start
    states = [one.state for one in fleet.outcomes]
    print(json.dumps([took, {one: states.count(one) for one in states}, fleet.outcomes[0].seams]))
"""


class Places(NamedTuple):
    """What is cleaned, how, and where to."""

    lake: Path
    recipe: Path
    out: Path


def on_spark(master: str, places: Places, *, stretch: int = 1 << 40, core: str = "", rounds: int = 2) -> Ran:
    """Clean a lake on Spark, in processes of its own, so often; the last time is told."""
    words = [master, *map(str, places), str(stretch), core, str(rounds)]
    environment = os.environ | ONE_THREAD
    ran = subprocess.run([sys.executable, "-c", PROGRAM, *words], capture_output=True, text=True, env=environment)
    if ran.returncode:
        raise SystemExit(ran.stderr[-2000:])
    return Ran(*json.loads(ran.stdout.splitlines()[-1]))


@contextmanager
def watched() -> Iterator[list[float]]:
    """Watch the memory of Spark's Python workers; give the most that one held so far, in MB."""
    most, done = [0.0], threading.Event()

    def watch() -> None:
        while not done.wait(0.2):
            for entry in Path("/proc").iterdir():
                if entry.name.isdigit():
                    most[0] = max(most[0], _held_mb(entry))

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield most
    finally:
        done.set()
        thread.join()


def _held_mb(process: Path) -> float:
    try:
        if b"pyspark" not in (process / "cmdline").read_bytes():
            return 0.0
        lines = (process / "status").read_text().splitlines()
    except OSError:  # it is gone
        return 0.0
    return sum(float(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


def size_of(folder: Path) -> int:
    """Return the bytes of all Parquet files in a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*.parquet"))


def lake_table(work: Path, sensors: int, repeats: int) -> tuple[list[str], float]:
    """Time the lake; return the table, and how many rows a second a core does on Spark."""
    rows, beside = sensors * EACH, Places(work / "lake", work / "r.toml", work / "plain")
    places = beside._replace(out=work / "spark")
    ways: dict[str, Callable[[], Ran]] = {
        "plain, one process on one core": lambda: plain_apart(beside),
        "Spark, one executor on that core": lambda: on_spark("local[1]", places, core=str(PINNED)),
        "Spark, `local-cluster[1,1,1024]`": lambda: on_spark("local-cluster[1,1,1024]", places),
        "Spark, `local-cluster[2,1,1024]`": lambda: on_spark("local-cluster[2,1,1024]", places),
    }
    took: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(repeats):
        for name, way in ways.items():
            ran = way()
            assert ran.states == {"cleaned": sensors}, ran
            took[name].append(ran.seconds)
            print(name, ran, flush=True)
    middle = {name: median(seconds) for name, seconds in took.items()}
    first, one, single, double = middle.values()
    ratios = (1.0, first / one, 1.0, single / double)
    asked = ("", f"at least {LEAST_SHARE}", "", f"at least {LEAST_SCALING}")
    lines = ["| way | seconds | M rows/s | ratio | asked |", "|---|---|---|---|---|"]
    for (name, seconds), ratio, wanted in zip(middle.items(), ratios, asked, strict=True):
        lines.append(f"| {name} | {seconds:.1f} | {rows / seconds / 1e6:.2f} | {ratio:.2f} | {wanted} |")
    both = [compared(beside.out / lake.name, places.out / lake.name) for lake in (work / "lake").iterdir()]
    assert sum(one.rows for one in both) == rows
    apart = sum(one.differ for one in both)
    lines.append(f"| numbers of Spark's that are not the plain ones to the bit | {apart} | | | 0 |")
    return lines, rows / one


def plain_apart(places: Places) -> Ran:
    """Run `plain` in a process of its own, pinned, once its kernels are loaded."""
    program = (
        "import json, os, sys; os.sched_setaffinity(0, {int(sys.argv[4])}); from pathlib import Path;"
        "import fleet_batch as b; lake, recipe, out = map(Path, sys.argv[1:4]);"
        "b.plain(lake, recipe, out); print(json.dumps(b.plain(lake, recipe, out)))"
    )
    words = [sys.executable, "-c", program, *map(str, places), str(PINNED)]
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": str(Path(__file__).parent)}
    ran = subprocess.run(words, capture_output=True, text=True, env=environment)
    if ran.returncode:
        raise SystemExit(ran.stderr[-2000:])
    return Ran(*json.loads(ran.stdout.splitlines()[-1]))


def endless_table(work: Path, rows: int) -> list[str]:
    """Time the endless sensor, whole and cut in time, and compare every row."""
    lines = [
        "| rows | filter | way | seconds | M rows/s | most MB of a worker | seams |",
        "|---|---|---|---|---|---|---|",
    ]
    for count in (rows // 10, rows):
        lake = work / f"endless-{count}"
        make_endless(lake, count)
        for mode in ("causal", "smoothed"):
            recipe = work / f"{mode}.toml"
            recipe.write_text((work / "r.toml").read_text().replace('mode = "causal"', f'mode = "{mode}"'))
            for name, stretch in (("whole", 1 << 40), ("cut in time", 1 << 23 if count == rows else 1 << 20)):
                with watched() as most:
                    ran = on_spark("local[2]", Places(lake, recipe, work / name), stretch=stretch, rounds=1)
                assert ran.states == {"cleaned": 1}, ran
                told = (
                    f"{count:,} | {mode} | {name} | {ran.seconds:.1f} | {count / ran.seconds / 1e6:.2f} | {most[0]:.0f}"
                )
                lines.append(f"| {told} | {ran.seams or 'none'} |")
                print(lines[-1], flush=True)
            found = compared(work / "whole" / "sensor=endless", work / "cut in time" / "sensor=endless")
            bits, far = f"{found.differ} numbers differ to the bit", f"{found.apart:.1e} apart at most"
            lines.append(f"| {found.rows:,} | {mode} | {bits if mode == 'causal' else far} | | | | |")
            print(lines[-1], flush=True)
        shutil.rmtree(lake)
    return lines


def model(work: Path, rows: int, rows_per_core: float) -> list[str]:
    """Return the arithmetic of a thousand sensors for a year."""
    samples = FLEET * YEAR_S * RATE_HZ
    bytes_in, bytes_out = (size_of(work / name) / rows for name in ("lake", "spark"))
    hours = samples / (rows_per_core * CORES) / 3600
    daily = FLEET * int(YEAR_S / 86_400)
    return [
        f"{FLEET:,} sensors for a year at {RATE_HZ:g} Hz are {samples:.3g} samples. A row of this lake has"
        f" {bytes_in:.1f} bytes, one of its output {bytes_out:.1f}: {samples * bytes_in / 1e12:.0f} TB are read and"
        f" {samples * bytes_out / 1e12:.0f} TB written. With a file a day that is {daily:,} files in, and as many out."
        f" As a task a sensor there are {FLEET:,} tasks; each sensor has {YEAR_S * RATE_HZ:.3g} rows, is cut into"
        f" {YEAR_S * RATE_HZ / (1 << 23):.0f} stretches, and makes {FLEET * YEAR_S * RATE_HZ / (1 << 23):,.0f} tasks."
        " Nothing is shuffled: what goes through Spark is a path and an outcome a task, some kilobytes."
        f" At {rows_per_core / 1e6:.2f} M rows/s a core, {CORES} cores take {hours:.1f} hours, if the disks give"
        f" {rows_per_core * CORES * (bytes_in + bytes_out) / 1e9:.1f} GB/s.",
    ]


def main() -> None:
    """Run all of it, and publish the page."""
    parser = page_parser(__doc__)
    parser.add_argument("--sensors", type=int, default=200)
    parser.add_argument("--rows", type=int, default=100_000_000, help="of the endless sensor")
    parser.add_argument("--repeats", type=int, default=3)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        make_lake(work / "lake", asked.sensors)
        tuning = [sys.executable, "-m", "becalm", "tune", str(work / "lake" / "sensor=000"), "--causal", "-o"]
        subprocess.run([*tuning, str(work / "r.toml")], check=True, capture_output=True)
        table, per_core = lake_table(work, asked.sensors, asked.repeats)
        arithmetic = model(work, asked.sensors * EACH, per_core)
        endless = endless_table(work, asked.rows)
    sections = [
        f"## {asked.sensors} sensors of {EACH:,} rows\n\n{asked.repeats} turns.",
        "\n".join(table),
        "## One endless sensor",
        "\n".join(endless),
        "## A thousand sensors for a year, on paper",
        *arithmetic,
    ]
    publish("A fleet on Spark", __doc__, "\n\n".join(sections), asked.output)


if __name__ == "__main__":
    main()
