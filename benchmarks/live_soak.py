"""A soak test: 1e8 samples go through `becalm live` at full speed, and are compared with a causal clean.

A recording of six channels at 10 kHz is replayed from a file as fast as possible through the filters of
`live_runs.recipe_of` (kinematic model of order 2, gate, limits) into a journal on disk. The rows of the journal are
compared with the output of `clean --causal` for the same readings in chunks: the signals must agree to 1e-12, every row
must exist once, and every number must be finite. Memory must stay constant: it is read twice a second, and the largest
value in each quarter of the time is given. *Filters alone* is the same without file and journal.

Run: python benchmarks/live_soak.py [--samples 1e8] [-o docs/live-soak.md]
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from becalm.cleaning.cleaner import Cleaner
from becalm.live.block import Block
from becalm.live.journal.reading import open_journal
from becalm.live.stream import Stream
from live_runs import Floats, LiveProcess, names_of, readings, recipe_of
from pages import page_parser, publish

CHANNELS, RATE_HZ, ROWS = 6, 10_000.0, 1 << 16
RECIPE, NAMES = recipe_of(CHANNELS, RATE_HZ), tuple(names_of(CHANNELS))


class Found(NamedTuple):
    """The comparison of a journal with a causal clean."""

    rows: int
    apart: float  # largest difference of two signals, in m/s^2
    finite: bool  # whether all numbers are finite


def blocks_of(count: int) -> Iterator[tuple[Floats, Floats]]:
    """Yield stamps and readings of `count` blocks."""
    some = readings(ROWS * 4, CHANNELS, RATE_HZ)
    for number in range(count):
        stamps = (number * ROWS + np.arange(ROWS)) / RATE_HZ
        yield stamps, some[number % 4 * ROWS :][:ROWS] + 1e-3 * np.sin(number)


def write_recording(path: Path, count: int) -> None:
    """Write `count` blocks to a file."""
    fields = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    fields += [pa.field(name, pa.float64(), metadata={"unit": "m/s^2"}) for name in NAMES]
    with pq.ParquetWriter(path, pa.schema(fields), compression="none", use_dictionary=False) as writer:
        for stamps, values in blocks_of(count):
            writer.write_table(pa.table([stamps, *values.T.copy()], schema=pa.schema(fields)))


def filters_alone(count: int) -> float:
    """Return how long the filters take, in seconds."""
    stream, took_s = Stream(RECIPE, 1 / RATE_HZ), 0.0
    for stamps, values in blocks_of(count):
        block = Block(NAMES, ("m/s^2",) * CHANNELS, stamps, values, "", np.ones(ROWS))
        begun = time.perf_counter()
        stream.take(block)
        took_s += time.perf_counter() - begun
    return took_s


def replay(folder: Path) -> tuple[float, list[float]]:
    """Replay the recording into a journal; return the time in seconds, and the memory during that time in MB."""
    (folder / "r.toml").write_text(RECIPE.to_toml(), encoding="utf-8")
    words = ["replay:recording.parquet?rows=16384", "--recipe", "r.toml", "--sink", "journal:kept"]
    begun, memory = time.perf_counter(), []
    live = LiveProcess(folder, words)
    while live.process.poll() is None:
        time.sleep(0.5)
        if held_bytes := live.status.get("memory_bytes"):
            memory.append(held_bytes / 1e6)
    if live.process.returncode:
        raise SystemExit(f"The stream ended with {live.process.returncode}: {live.said()}")
    return time.perf_counter() - begun, memory


def compare(journal: Path, count: int) -> Found:
    """Compare a journal with a causal clean of the same readings."""
    row, apart, finite, rest = 0, 0.0, True, None
    with open_journal(journal) as reader, Cleaner(RECIPE, 1 / RATE_HZ) as cleaner:
        tables = reader.tables()
        for number, (_, values) in enumerate(blocks_of(count)):
            elapsed = np.ones(ROWS)
            elapsed[0] = float(number > 0)
            (filed,) = cleaner.push([np.ascontiguousarray(column) for column in values.T], elapsed)
            while rest is None or len(rest) < ROWS:
                more = next(tables)
                rest = more if rest is None else pa.concat_tables([rest, more], promote_options="default")
            kept, rest = rest.slice(0, ROWS), rest.slice(ROWS)
            if not np.array_equal(kept["row"].to_numpy(), np.arange(row, row + ROWS)):
                raise SystemExit(f"The rows from {row} on are not there once each.")
            row += ROWS
            for name, expected in zip(NAMES, filed, strict=True):
                live, known = kept[name].to_numpy(), np.isfinite(expected.signal)
                finite = finite and bool(np.isfinite(live[known]).all())
                apart = max(apart, float(np.abs(live[known] - expected.signal[known]).max()))
    return Found(row, apart, finite)


def main() -> None:
    """Run the soak."""
    parser = page_parser(__doc__)
    parser.add_argument("--samples", type=float, default=1e8, help="rows times channels")
    arguments = parser.parse_args()
    count = max(4, round(arguments.samples / CHANNELS / ROWS))
    samples = count * ROWS * CHANNELS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_recording(folder / "recording.parquet", count)
        took_s, memory = replay(folder)
        size = sum(path.stat().st_size for path in (folder / "kept").rglob("*") if path.is_file())
        found = compare(folder / "kept", count)
    alone_s, quarters = filters_alone(count), [max(part) for part in np.array_split(memory, 4)]
    lines = ["| |", "|---|--:|", f"samples | {samples:.3g}"]
    lines += [f"seconds, file to journal | {took_s:.1f}", f"samples a second | {samples / took_s:.3g}"]
    lines += [f"journal, MB | {size / 1e6:.0f}"]
    lines += [f"greatest memory in each quarter of that time, MB | {', '.join(f'{most:.0f}' for most in quarters)}"]
    lines += [f"rows in the journal, each once | {found.rows}"]
    lines += [f"farthest from the file's way, m/s^2 | {found.apart:.2g}"]
    lines += [f"all finite | {'yes' if found.finite else 'NO'}"]
    lines += [f"filters alone, samples a second | {samples / alone_s:.3g}"]
    publish("A soak of a live stream", __doc__, "\n".join(lines) + "\n", arguments.output)


if __name__ == "__main__":
    main()
