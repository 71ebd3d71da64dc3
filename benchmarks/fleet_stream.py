"""A stream over a fleet, killed and timed: no row is lost or written twice, and the cost of a row.

*Killed*: files of four sensors arrive in a lake, and a stream on a small Spark cluster (two executors in separate
processes) filters them into Parquet files. Meanwhile its processes are killed (SIGKILL) one after the other at random
times: the Python driver, its JVM, an executor, a Python worker. At the end, the files that the output's log lists must
be what one uninterrupted stream writes: every row once, in order, bitwise equal. Killed processes leave files that the
log does not list; they do not count, but a program that reads all files in the folder reads them too.

*Timed*: sensors of two channels, one sample per row or blocks of 500, in micro-batches of a million rows on two cores;
the median of the micro-batches in which the JVM was warm. Two ways in which Spark passes rows to Python are compared:
as `Row`, which becalm uses, and as pandas frames. On a local disk without Hadoop's native library, each written file
costs the JVM some 10 ms for subprocesses that only run `chmod`; with many sensors this is most of the time.

Run: python benchmarks/fleet_stream.py [--kills 16] [--only killed,timed] [-o docs/fleet-stream.md]
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from fleet_stream_kills import killed
from fleet_stream_timing import Fleet, in_frames, timed
from pages import page_parser, publish

FLEETS = {
    "100 sensors, a row a sample": Fleet(100, 10_000),
    "100 sensors, blocks of 500": Fleet(100, 10_000, 500),
    "10 sensors, a row a sample": Fleet(10, 100_000),
    "1000 sensors, a row a sample": Fleet(1000, 1000),
}
FRAMES = ("100 sensors, a row a sample", "1000 sensors, a row a sample")


def kills(count: int) -> str:
    """Kill processes of a stream; return a table of the result."""
    with tempfile.TemporaryDirectory() as folder:
        found = killed(Path(folder), count, lambda kind: print(f"killed: {kind}", flush=True))
    who = ", ".join(f"{kind} {times}" for kind, times in found.kills.items())
    head = "killed | rows | files that do not count | what counts\n---|--:|--:|---\n"
    return f"{head}{who} | {found.rows} | {found.orphans} | {found.says}\n"


def costs() -> str:
    """Time streams; return a table."""
    from becalm.fleet.session import session

    lines = ["in a micro-batch | handed over as | rows/s | JVM, s/million rows | Python, s/million rows"]
    lines.append("---|---|--:|--:|--:")
    with session("local[2]", {"spark.driver.memory": "3g"}) as spark:
        for title, fleet in FLEETS.items():
            for how in ("Row", "pandas") if title in FRAMES else ("Row",):
                with tempfile.TemporaryDirectory() as folder:
                    if how == "pandas":
                        with in_frames():
                            cost = timed(spark, Path(folder), fleet)
                    else:
                        cost = timed(spark, Path(folder), fleet)
                rate = f"{1e6 / cost.wall_s:,.0f}".replace(",", " ")
                lines.append(f"{title} | {how} | {rate} | {cost.jvm_s:.1f} | {cost.python_s:.1f}")
                print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the parts of the benchmark, and publish the page."""
    parser = page_parser(__doc__)
    parser.add_argument("--kills", type=int, default=16, help="how many processes are killed")
    parser.add_argument("--only", default="killed,timed", help="parts, with commas")
    arguments = parser.parse_args()
    parts = {"killed": lambda: kills(arguments.kills), "timed": costs}
    text = "\n".join(parts[name]() for name in arguments.only.split(","))
    publish("Streams over a fleet", __doc__, text, arguments.output)


if __name__ == "__main__":
    main()
