"""A very long sensor that is cleaned in stretches, compared with the same sensor as one task.

It has four files, not in the order of time, missing stretches and a gap; a time in seconds and one channel, float64. As
a whole it is one task; cut in time, each task has a stretch of 8 388 608 rows (1 048 576 for the shorter record). All
rows of both outputs are compared: bitwise for a causal filter, by the largest difference relative to the largest number
for a smoother. The times include the start of Spark's workers, but not of Spark itself. Memory is the peak of any
Python worker (VmHWM).

Run: python benchmarks/fleet_endless.py [--rows 100000000] [-o docs/fleet-endless.md]
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fleet_comparing import compared
from fleet_lakes import make_endless
from fleet_spark import Places, on_spark
from pages import page_parser, publish

TUNED_ON = 400_000  # rows


@contextmanager
def watched() -> Iterator[list[float]]:
    """Watch the memory of Spark's Python workers; yield a list with the peak of any worker so far, in MB."""
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
    except OSError:  # the process has ended
        return 0.0
    return sum(float(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


def endless_table(work: Path, rows: int) -> list[str]:
    """Time the long sensor, as a whole and cut in time, and compare all rows."""
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
                cells = (
                    f"{count:,} | {mode} | {name} | {ran.seconds:.1f} | {count / ran.seconds / 1e6:.2f} | {most[0]:.0f}"
                )
                lines.append(f"| {cells} | {ran.seams or 'none'} |")
                print(lines[-1], flush=True)
            found = compared(work / "whole" / "sensor=endless", work / "cut in time" / "sensor=endless")
            bits, far = f"{found.differ} numbers differ to the bit", f"{found.apart:.1e} apart at most"
            lines.append(f"| {found.rows:,} | {mode} | {bits if mode == 'causal' else far} | | | | |")
            print(lines[-1], flush=True)
        shutil.rmtree(lake)
    return lines


def main() -> None:
    """Run the benchmark, and publish the page."""
    parser = page_parser(__doc__)
    parser.add_argument("--rows", type=int, default=100_000_000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        make_endless(work / "some", TUNED_ON)
        tuning = [sys.executable, "-m", "becalm", "tune", str(work / "some" / "sensor=endless"), "--causal", "-o"]
        subprocess.run([*tuning, str(work / "r.toml")], check=True, capture_output=True)
        table = endless_table(work, arguments.rows)
    publish("An endless sensor on Spark", __doc__, "\n".join(table), arguments.output)


if __name__ == "__main__":
    main()
