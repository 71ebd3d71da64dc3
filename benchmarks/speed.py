"""How long the command line takes: --help, the first clean of a new copy, and later ones.

A CSV of 100 000 rows x 6 channels at 100 Hz is smoothed without options. Times are wall-clock seconds of
whole processes; the first run is that of a copy of becalm that never ran before. For comparison, pyarrow alone
reads the CSV and writes a CSV of the output's size.

The last rows are the times to choose the filter of one channel of a million samples, with all orders and tones, in a
running process: for a random walk in white noise, and for the same with five tones.

Run: python benchmarks/speed.py [-o docs/speed.md]
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np
import pyarrow as pa
from pyarrow import csv

import becalm
from becalm.identification.choose import choose
from pages import page_parser, publish

ROWS, CHANNELS, REPEATS = 100_000, 6, 5
SAMPLES = 1_000_000
TONES = (0.01, 0.023, 0.11, 0.2, 0.31)  # cycles a sample


def make(path: Path) -> None:
    """Write the recording: random walks of different step sizes in white noise."""
    rng = np.random.default_rng(3)
    columns = {"time_s": np.arange(ROWS) / 100}
    for i in range(CHANNELS):
        walk = np.cumsum(rng.normal(0, 10.0 ** (-i / 2), ROWS))
        columns[f"channel_{i}"] = walk + rng.normal(0, 1, ROWS)
    csv.write_csv(pa.table(columns), path)


def seconds(words: list[str], site: Path) -> float:
    """Run a command with the copy of becalm in a folder; return its wall-clock time in seconds."""
    environment = {**os.environ, "PYTHONPATH": str(site)}
    start = time.perf_counter()
    ran = subprocess.run([sys.executable, "-m", "becalm", *words], capture_output=True, env=environment, check=False)
    if ran.returncode not in (0, 4):
        raise SystemExit(ran.stderr.decode())
    return time.perf_counter() - start


def copying(source: Path, target: Path) -> float:
    """Return the seconds that pyarrow needs to read the file and write the output's columns."""
    start = time.perf_counter()
    table = csv.read_csv(source)
    doubled = {name: table[name] for name in table.column_names}
    doubled |= {f"{name}_sigma": table[name] for name in table.column_names[1:]}
    csv.write_csv(pa.table(doubled), target)
    return time.perf_counter() - start


def choosing() -> list[str]:
    """Measure the choice of a filter; return the rows of the table."""
    rng, k = np.random.default_rng(3), np.arange(SAMPLES)
    walk = np.cumsum(rng.normal(0, 0.05, SAMPLES)) + rng.normal(size=SAMPLES)
    tones = sum((np.sin(2 * np.pi * cycles * k) for cycles in TONES), walk)
    rows = []
    for causal in (False, True):
        for what, z in (("walk", walk), ("walk and five tones", tones)):
            start = time.perf_counter()
            found = choose(z, np.ones(SAMPLES), causal).tuning
            took, count = time.perf_counter() - start, len(found.tones) if found else 0
            mode = "causal" if causal else "smoothed"
            rows.append(f"| choosing, 1 000 000 samples, {what}, {mode}: {count} tones found | under 10 | {took:.1f} |")
    return rows


def table() -> str:
    """Measure, and return the table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source, site = folder / "in.csv", folder / "site"
        make(source)
        package = Path(becalm.__file__).parent
        shutil.copytree(package, site / "becalm", ignore=shutil.ignore_patterns("__pycache__"))
        words = ["clean", str(source), "-o", str(folder / "out.csv")]
        first = seconds(words, site)
        again = median(seconds(words, site) for _ in range(REPEATS))
        recipe = [*words, "--recipe", str(folder / "out.csv.recipe.toml")]
        with_recipe = median(seconds(recipe, site) for _ in range(REPEATS))
        help_page = median(seconds(["--help"], site) for _ in range(REPEATS))
        copied = median(copying(source, folder / "copy.csv") for _ in range(REPEATS))
    return "\n".join(
        [
            "| job | asked | seconds |",
            "|---|---|---|",
            f"| `becalm --help` | under 0.4 | {help_page:.2f} |",
            f"| clean 100 000 x 6 CSV, first run of a copy | under 3 | {first:.2f} |",
            f"| the same again | under 3 | {again:.2f} |",
            f"| the same, with its recipe | | {with_recipe:.2f} |",
            f"| reading it and writing as many columns with pyarrow, in a running process | | {copied:.2f} |",
            *choosing(),
            "",
        ]
    )


def main() -> None:
    """Print the table; with -o, write it as a page."""
    output = page_parser(__doc__).parse_args().output
    publish("Speed of the command line", __doc__, table(), output)


if __name__ == "__main__":
    main()
