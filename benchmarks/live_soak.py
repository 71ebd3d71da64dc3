"""A soak at full speed: 1e8 samples through `becalm live`, from a file into a journal, held against the file's way.

A recording of six channels at 10 kHz is replayed as fast as it goes through the filters of `live_runs.recipe_of`
(motion of order 2, gate, limits) into a journal on disk. What the journal then holds is compared, row by row, with
what `clean --causal`'s way makes of the same readings in chunks: the signals must agree to 1e-12, every row be there
once, every number be finite. Memory must stay flat: what the process holds is asked twice a second, and the greatest
is told of each quarter. *Filters alone* is the same without file and journal.

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
    """What was found of a journal."""

    rows: int
    apart: float
    finite: bool


def blocks_of(count: int) -> Iterator[tuple[Floats, Floats]]:
    """Make stamps and readings, a block at a time."""
    some = readings(ROWS * 4, CHANNELS, RATE_HZ)
    for number in range(count):
        stamps = (number * ROWS + np.arange(ROWS)) / RATE_HZ
        yield stamps, some[number % 4 * ROWS :][:ROWS] + 1e-3 * np.sin(number)


def write_recording(path: Path, count: int) -> None:
    """Write them to a file."""
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
    """Replay the recording into a journal; return how long that took, and the memory meanwhile in MB."""
    (folder / "r.toml").write_text(RECIPE.to_toml(), encoding="utf-8")
    words = ["replay:recording.parquet?rows=16384", "--recipe", "r.toml", "--sink", "journal:kept"]
    begun, memory = time.perf_counter(), []
    live = LiveProcess(folder, words)
    while live.process.poll() is None:
        time.sleep(0.5)
        if told := live.status.get("memory_bytes"):
            memory.append(told / 1e6)
    if live.process.returncode:
        raise SystemExit(f"The stream ended with {live.process.returncode}: {live.said()}")
    return time.perf_counter() - begun, memory


def compare(journal: Path, count: int) -> Found:
    """Hold a journal against the file's way."""
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
            for name, told in zip(NAMES, filed, strict=True):
                live, known = kept[name].to_numpy(), np.isfinite(told.signal)
                finite = finite and bool(np.isfinite(live[known]).all())
                apart = max(apart, float(np.abs(live[known] - told.signal[known]).max()))
    return Found(row, apart, finite)


def main() -> None:
    """Run the soak."""
    parser = page_parser(__doc__)
    parser.add_argument("--samples", type=float, default=1e8, help="rows times channels")
    asked = parser.parse_args()
    count = max(4, round(asked.samples / CHANNELS / ROWS))
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
    publish("A soak of a live stream", __doc__, "\n".join(lines) + "\n", asked.output)


if __name__ == "__main__":
    main()
