"""A live stream of six channels written to the journal, compared with the same bytes written to a plain file.

Each block is committed in a transaction that is on the disk when it ends: time, raw, clean, sigma and verdict of
each row, a snapshot of the filters (4 kB) and the position. The rival appends the same arrays, as they are in
memory, to a file, and calls fsync after each block; it does not compress, checksum or index them, and does not
record the position of the stream. Both take turns on the same disk; medians are given. The journal is read again,
and every number is compared. A core's share is the processor time of the commits alone, at 10 kHz. Rolling moves a
closed stretch from the database to Parquet, with a check and a record, in another thread than the stream; its rival
is pyarrow, which writes the same table from memory.

Run: python benchmarks/journal_writing.py [--seconds 30] [--repeats 5] [-o docs/journal-writing.md]
"""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from becalm.live.address import Address
from becalm.live.block import Checkpoint, Head, Output
from becalm.live.journal.journal import Journal
from becalm.live.journal.reading import open_journal
from pages import page_parser, publish

CHANNELS, RATE_HZ, START_S = 6, 10_000, 1_700_000_000
BLOCKS = {"0.05 s": 500, "1 s": 10_000, "10 s": 100_000}
SNAPSHOT, RECIPE = bytes(4096), "recipe = 1\n"
HEAD = Head(tuple(f"channel_{i}" for i in range(CHANNELS)), ("m/s^2",) * CHANNELS, RATE_HZ, RECIPE)
PARTS = ("time_s", "values", "signal", "sigma", "verdicts")


def outputs(rows: int, block: int) -> list[Output]:
    """Return the output of a stream: random walks with noise, the walks as clean values, and a constant sigma."""
    rng = np.random.default_rng(3)
    signal = np.cumsum(rng.normal(0, 0.1, (rows, CHANNELS)), axis=0)
    values, stamps = signal + rng.normal(size=signal.shape), START_S + np.arange(rows) / RATE_HZ
    sigma, verdicts = np.full(signal.shape, 0.25), np.zeros(signal.shape, np.int8)
    cuts = [slice(first, first + block) for first in range(0, rows, block)]
    return [Output(c.start, stamps[c], values[c], signal[c], sigma[c], verdicts[c]) for c in cuts]


def commit_all(folder: Path, stream: list[Output], options: str = "?roll=1d") -> tuple[float, float]:
    """Commit a stream to a journal; return the wall-clock and the processor time in seconds."""
    journal = Journal(Address.parsed(f"journal:{folder}{options}"))
    journal.last()
    journal.open(HEAD)
    begun, spent = time.perf_counter(), time.process_time()
    for one in stream:
        rows = one.first_row + len(one)
        journal.commit([one], Checkpoint(rows, f'{{"row": {rows}}}', SNAPSHOT, RECIPE, "replay:drive.csv"))
    took = time.perf_counter() - begun, time.process_time() - spent
    journal.close()
    return took


def append(path: Path, stream: list[Output]) -> float:
    """Append the arrays of a stream to a file, with fsync after each block; return the seconds."""
    begun = time.perf_counter()
    with path.open("wb") as file:
        for one in stream:
            for part in PARTS:
                file.write(getattr(one, part).data)
            file.write(SNAPSHOT)
            file.flush()
            os.fsync(file.fileno())
    return time.perf_counter() - begun


def check(folder: Path, stream: list[Output]) -> None:
    """Exit with an error if a number in the journal differs from the stream."""
    with open_journal(folder) as journal:
        found = pa.concat_tables(list(journal.tables())).slice(0, stream[-1].first_row + len(stream[-1]))
    for channel, name in enumerate(HEAD.names):
        for ending, part in {"": "signal", "_raw": "values", "_sigma": "sigma"}.items():
            kept = np.concatenate([getattr(one, part)[:, channel] for one in stream])
            if found[name + ending].to_numpy().tobytes() != kept.tobytes():
                raise SystemExit(f"{name}{ending} is not what was kept.")


def writing(seconds: int, repeats: int) -> list[str]:
    """Measure the commits; return a table with a row for each length of a block."""
    lines = ["| block | journal, rows/s | plain file, rows/s | ratio | a core's share |", "|---|---|---|---|---|"]
    for name, block in BLOCKS.items():
        rows = seconds * RATE_HZ
        stream = outputs(rows, block)
        took: list[tuple[float, float, float]] = []
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as folder:
                kept, spent = commit_all(Path(folder) / "journal", stream)
                took.append((kept, spent, append(Path(folder) / "plain", stream)))
                check(Path(folder) / "journal", stream)
        ratio = median(kept / plain for kept, _, plain in took)
        speeds = [f"{rows / median(times) / 1e6:.2f} M" for times in zip(*took, strict=True)]
        share = median(spent for _, spent, _ in took) / seconds
        lines.append(f"| {name} | {speeds[0]} | {speeds[2]} | {ratio:.1f} | {share:.1%} |")
    return lines


def rolling(seconds: int, repeats: int) -> str:
    """Measure rolling; return a sentence with the result."""
    rows = seconds * RATE_HZ
    stream = outputs(rows, RATE_HZ)
    kept, rivals = [], []
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            commit_all(folder / "journal", stream)
            with open_journal(folder / "journal") as journal:
                table = pa.concat_tables(list(journal.tables()))
            begun = time.perf_counter()
            pq.write_table(table, folder / "rival", compression="zstd")
            rivals.append(time.perf_counter() - begun)
            kept.append(roll(folder / "journal", stream[-1]))
            check(folder / "journal", stream)
    ratio = median(own / rival for own, rival in zip(kept, rivals, strict=True))
    speed = rows / median(kept) / 1e6
    return f"Rolled into Parquet: {speed:.2f} M rows/s, {ratio:.1f} times as long as pyarrow's writing alone."


def roll(folder: Path, last: Output) -> float:
    """Commit rows of a later day, so that all earlier rows are rolled; return the seconds until that is recorded."""
    journal = Journal(Address.parsed(f"journal:{folder}?roll=1d"))
    checkpoint = journal.last()
    if checkpoint is None:
        raise SystemExit("The journal tells no checkpoint.")
    journal.open(HEAD)
    rows = checkpoint.rows + len(last)
    later = replace(last, first_row=checkpoint.rows, time_s=last.time_s + 2 * 86_400)
    begun = time.perf_counter()
    journal.commit([later], replace(checkpoint, rows=rows))
    settled = journal.wait_until_rolled(600)
    took = time.perf_counter() - begun
    journal.close()
    if not settled or not list(folder.glob("*/*.parquet")):
        raise SystemExit("The journal did not roll.")
    return took


def main() -> None:
    """Print the table; with -o, write it as a page."""
    parser = page_parser(__doc__)
    parser.add_argument("--seconds", type=int, default=30, help="of the stream")
    parser.add_argument("--repeats", type=int, default=5, help="turns")
    arguments = parser.parse_args()
    lines = [
        f"{arguments.seconds} s at 10 kHz, {arguments.repeats} turns.",
        "",
        *writing(arguments.seconds, arguments.repeats),
    ]
    lines += ["", rolling(arguments.seconds, arguments.repeats), "", "Every number was read again as it was kept.", ""]
    text = "\n".join(lines)
    publish("Writing a journal", __doc__, text, arguments.output)


if __name__ == "__main__":
    main()
