"""A stream over a fleet, killed and timed: nothing is lost, nothing told twice, and what a row costs.

*Killed*: files of four sensors come into a lake, and a stream on a small cluster of Spark's (two executors in processes
of their own) filters them into Parquet files. Meanwhile one of its processes after the other is killed (SIGKILL) at
random moments: the Python driver, its JVM, an executor, a Python worker. What counts at the end, by the output's log,
must be what one uninterrupted stream gives: every row once, in order, to the bit. Files that do not count are what
killed processes left; whoever reads all files in the folder reads them too.

*Timed*: sensors of two channels, a row a sample or blocks of 500, in micro-batches of a million rows on two cores; the
median of those in which the JVM was warm. Spark's two ways of handing rows to Python are compared: as `Row`, which
becalm uses, and as pandas frames. On a local disk without Hadoop's native library each file that is written costs some
10 ms of the JVM's, for processes that do nothing but `chmod`; with many sensors that is most of it.

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
    """Kill; return what was left as a table."""
    with tempfile.TemporaryDirectory() as folder:
        found = killed(Path(folder), count, lambda kind: print(f"killed: {kind}", flush=True))
    who = ", ".join(f"{kind} {times}" for kind, times in found.kills.items())
    head = "killed | rows | files that do not count | what counts\n---|--:|--:|---\n"
    return f"{head}{who} | {found.rows} | {found.orphans} | {found.says}\n"


def costs() -> str:
    """Time; return a table."""
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
    """Kill and time."""
    parser = page_parser(__doc__)
    parser.add_argument("--kills", type=int, default=16, help="how many processes are killed")
    parser.add_argument("--only", default="killed,timed", help="parts, with commas")
    asked = parser.parse_args()
    parts = {"killed": lambda: kills(asked.kills), "timed": costs}
    text = "\n".join(parts[name]() for name in asked.only.split(","))
    publish("Streams over a fleet", __doc__, text, asked.output)


if __name__ == "__main__":
    main()
