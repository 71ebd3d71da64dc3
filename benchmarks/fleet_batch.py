"""A lake on Spark compared with one plain process, and an estimate for a large fleet.

The lake has 200 sensors of 200 000 rows (two files each, not in the order of time; some with missing stretches and a
gap), a time in seconds and one channel of a random walk in white noise, float64, snappy; the recipe is causal and was
tuned on one sensor. *Plain* is one process, pinned to one core, that cleans the sensors in sequence with the function
that a task of Spark runs. The times leave out Spark's start and the first task of each worker, which loads becalm: the
same job runs once before. *On that core* pins all processes of Spark (driver, JVM and Python worker) to that core. In
clusters each executor, with its worker, is pinned to a core, and the driver is not pinned. The ways take turns; medians
are given. *Ratio* compares rows per second with the plain process, and two executors with one. All rows of the last
outputs of the plain process and of Spark are compared.

The estimate at the end is arithmetic with the measured numbers.

Run: python benchmarks/fleet_batch.py [--sensors 200] [--repeats 3] [-o docs/fleet-batch.md]
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

from becalm.fleet import open_book
from becalm.fleet.job import Job, Sensor
from becalm.fleet.lake import places_in
from becalm.fleet.sensor_cleaning import clean_whole
from fleet_comparing import compared
from fleet_lakes import EACH, RATE_HZ, make_lake
from fleet_spark import ONE_THREAD, Places, Ran, on_spark
from pages import page_parser, publish

PINNED = 0  # number of the core
LEAST_SHARE, LEAST_SCALING = 0.9, 1.7
"""Required ratios: Spark on one core to the plain process, and two executors to one."""

YEAR_S, FLEET, CORES = 365.25 * 86_400, 1000, 100


def plain(lake: Path, recipe: Path, out: Path) -> Ran:
    """Clean a lake in this process, one sensor at a time."""
    shutil.rmtree(out, ignore_errors=True)
    book = open_book(recipe)
    sensors = [Sensor(place.name, place.bytes, str(book.hash_for(place.name))) for place in places_in(lake)]
    job = Job(str(lake), str(out), book.by_hash)
    start = time.perf_counter()
    states = [clean_whole(job, sensor).state for sensor in sensors]
    return Ran(time.perf_counter() - start, {state: states.count(state) for state in states})


def size_of(folder: Path) -> int:
    """Return the bytes of all Parquet files in a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*.parquet"))


def lake_table(work: Path, sensors: int, repeats: int) -> tuple[list[str], float]:
    """Time all ways to clean the lake; return the table, and the rows per second of a core on Spark."""
    rows, plain_places = sensors * EACH, Places(work / "lake", work / "r.toml", work / "plain")
    places = plain_places._replace(out=work / "spark")
    ways: dict[str, Callable[[], Ran]] = {
        "plain, one process on one core": lambda: plain_in_subprocess(plain_places),
        "Spark, `local[1]`, on that core": lambda: on_spark("local[1]", places, core=str(PINNED)),
        "Spark, one executor": lambda: on_spark("local-cluster[1,1,1024]", places),
        "Spark, two executors": lambda: on_spark("local-cluster[2,1,1024]", places),
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
    both = [compared(plain_places.out / lake.name, places.out / lake.name) for lake in (work / "lake").iterdir()]
    assert sum(one.rows for one in both) == rows
    different = sum(one.differ for one in both)
    lines.append(f"| numbers of Spark's that are not the plain ones to the bit | {different} | | | 0 |")
    return lines, rows / one


def plain_in_subprocess(places: Places) -> Ran:
    """Run `plain` in a subprocess that is pinned to a core."""
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


def model(work: Path, rows: int, rows_per_core: float) -> list[str]:
    """Return the estimate for a thousand sensors over a year."""
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
    """Run the benchmark, and publish the page."""
    parser = page_parser(__doc__)
    parser.add_argument("--sensors", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        make_lake(work / "lake", arguments.sensors)
        tuning = [sys.executable, "-m", "becalm", "tune", str(work / "lake" / "sensor=000"), "--causal", "-o"]
        subprocess.run([*tuning, str(work / "r.toml")], check=True, capture_output=True)
        table, per_core = lake_table(work, arguments.sensors, arguments.repeats)
        arithmetic = model(work, arguments.sensors * EACH, per_core)
    sections = [
        f"## {arguments.sensors} sensors of {EACH:,} rows\n\n{arguments.repeats} turns.",
        "\n".join(table),
        "## A thousand sensors for a year, on paper",
        *arithmetic,
    ]
    publish("A fleet on Spark", __doc__, "\n\n".join(sections), arguments.output)


if __name__ == "__main__":
    main()
