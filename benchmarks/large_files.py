"""`becalm clean` with a recipe on a large Parquet file, compared with reading and writing the file with pyarrow.

A time column and six channels of random walks in white noise, float64, snappy. Wall-clock times of whole
processes, which take turns; medians are given, and the peak memory of any run. pyarrow reads the whole table
and writes it unchanged; becalm also writes a column of uncertainties for each channel. Every output
must have all rows; for a small file, every number is compared with the result of `becalm.clean`.

Run: python benchmarks/large_files.py [--rows 10000000] [--repeats 7] [-o docs/large-files.md]
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pages import page_parser, publish

CHANNELS, BLOCK = 6, 1 << 20
SMALL, EQUAL = 20_000, 1e-10
"""Rows of the file whose numbers are compared, and the largest difference relative to a column's largest number."""

MODES: dict[str, list[str]] = {"causal": ["--causal"], "smoothed": []}
NOT_DESCRIBED = 4
COPY = "import sys, pyarrow.parquet as pq; pq.write_table(pq.read_table(sys.argv[1]), sys.argv[2])"


class Ran(NamedTuple):
    """The cost of one process."""

    seconds: float
    megabytes: float  # peak memory
    described: bool  # whether the model describes its channel for all channels


def make(path: Path, rows: int) -> None:
    """Write the recording, a block at a time."""
    rng, last = np.random.default_rng(3), np.zeros(CHANNELS)
    writer: pq.ParquetWriter | None = None
    for first in range(0, rows, BLOCK):
        count = min(BLOCK, rows - first)
        columns = {"time_s": (first + np.arange(count)) / 1000}
        for i in range(CHANNELS):
            walk = last[i] + np.cumsum(rng.normal(0, 10.0 ** (-i / 2 - 1), count))
            last[i] = walk[-1]
            columns[f"channel_{i}"] = walk + rng.normal(0, 1, count)
        table = pa.table(columns)
        writer = writer or pq.ParquetWriter(path, table.schema)
        writer.write_table(table)
    if writer:
        writer.close()


def run(words: list[str]) -> Ran:
    """Run a process to its end."""
    start = time.perf_counter()
    with subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, NOT_DESCRIBED):
        raise SystemExit(f"{' '.join(words)} ended with exit code {process.returncode}.")
    return Ran(time.perf_counter() - start, usage.ru_maxrss / 1024, process.returncode != NOT_DESCRIBED)


def tune(source: Path, mode: str) -> list[str]:
    """Tune a recipe; return the arguments that clean the file with it, to `mode`.parquet in the same folder."""
    recipe, output = str(source.with_name(f"{mode}.toml")), str(source.with_name(f"{mode}.parquet"))
    run(["-m", "becalm", "tune", str(source), "-o", recipe, *MODES[mode]])
    return ["-m", "becalm", "clean", str(source), "-o", output, "--recipe", recipe]


def check_rows(path: Path, rows: int) -> None:
    """Exit with an error if a file does not have this number of rows."""
    found = pq.read_metadata(path).num_rows
    if found != rows:
        raise SystemExit(f"{path.name} has {found} rows; the input has {rows}.")


def compare() -> str:
    """Clean a small file, compare every number with `becalm.clean`, and return a sentence on the largest difference."""
    import becalm  # after all measurements: a subprocess starts with the memory of this process

    worst = 0.0
    with tempfile.TemporaryDirectory() as name:
        source = Path(name) / "in.parquet"
        make(source, SMALL)
        for mode in MODES:
            run(tune(source, mode))
            output = source.with_name(f"{mode}.parquet")
            check_rows(output, SMALL)
            written = pq.read_table(output)
            expected = becalm.clean(becalm.read(source), becalm.Recipe.load(source.with_name(f"{mode}.toml")))
            for i in range(CHANNELS):
                for column, record in ((f"channel_{i}", expected.signal), (f"channel_{i}_sigma", expected.sigma)):
                    numbers = record.samples[:, i]
                    difference = np.abs(written[column].to_numpy() - numbers).max() / np.abs(numbers).max()
                    if not difference <= EQUAL:  # NaN must fail too
                        raise SystemExit(f"{mode}, {column}: differs from becalm.clean by {difference:.0e}.")
                    worst = max(worst, float(difference))
    return f"Of {SMALL:,} rows every number is that of `becalm.clean`; the largest difference is {worst:.0e}.\n"


def table(rows: int, repeats: int) -> str:
    """Measure, and return the table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = folder / "in.parquet"
        make(source, rows)
        jobs = {"pyarrow: read and write": ["-c", COPY, str(source), str(folder / "copy.parquet")]}
        for mode in MODES:
            jobs[f"becalm clean, {mode}"] = tune(source, mode)
        took: dict[str, list[Ran]] = {job: [] for job in jobs}
        for _ in range(repeats):
            for job, words in jobs.items():
                took[job].append(run(words))
        for output in ("copy", *MODES):
            check_rows(folder / f"{output}.parquet", rows)
    asked = {"becalm clean, causal": "at most 1.6", "becalm clean, smoothed": "at most 2"}
    base = [ran.seconds for ran in next(iter(took.values()))]
    lines = [
        f"{rows:,} rows, {repeats} turns.",
        "",
        "| job | seconds | ratio | asked | most MB |",
        "|---|---|---|---|---|",
    ]
    for job, runs in took.items():
        ratio = median(ran.seconds / copied for ran, copied in zip(runs, base, strict=True))
        most = max(ran.megabytes for ran in runs)
        seconds = median(ran.seconds for ran in runs)
        lines.append(f"| {job} | {seconds:.2f} | {ratio:.2f} | {asked.get(job, '')} | {most:.0f} |")
    doubtful = [job for job, runs in took.items() if not all(ran.described for ran in runs)]
    if doubtful:
        lines += ["", f"Not every channel was described by its model (exit code 4): {', '.join(doubtful)}."]
    return "\n".join([*lines, ""])


def main() -> None:
    """Print the table; with -o, write it as a page."""
    parser = page_parser(__doc__)
    parser.add_argument("--rows", type=int, nargs="+", default=[10_000_000], help="how long; several may be given")
    parser.add_argument("--repeats", type=int, default=7, help="turns")
    arguments = parser.parse_args()
    text = "\n".join(table(rows, arguments.repeats) for rows in arguments.rows)
    publish("Large files", __doc__, f"{text}\n{compare()}", arguments.output)


if __name__ == "__main__":
    main()
