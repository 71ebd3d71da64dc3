"""Sinks of a stream, compared with the simplest way of writing the same rows to the same place.

Six channels, 10,000 rows at a time, which is one second at 10 kHz; each commit includes filters of 20 kB and a
position. *parquet*: pyarrow writes the same tables into one file. *delta*: deltalake appends the same tables.
*postgres*: psycopg sends bytes that are prepared in advance to an equal table, so that only the server's time counts; a
real server on this machine syncs to its disk. Both ways take turns, and the shortest time of each counts; every row
must exist at the end. The time of parquet includes the completion of the last file; its clean copy is also synced to
the disk.

Run: python benchmarks/live_sinks.py [--rows 500000] [--repeats 3] [-o docs/live-sinks.md]
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow.parquet as pq

from becalm.live.address import Address
from becalm.live.block import Checkpoint, Head, Output
from becalm.live.protocols import CheckpointSink
from becalm.live.sinks.delta import DeltaSink
from becalm.live.sinks.parquet import ParquetSink
from becalm.live.sinks.postgres import PostgresSink
from becalm.live.sinks.postgres_rows import COPY_HEADER, COPY_TRAILER, BinaryRows
from becalm.live.tables import output_table
from live_postgres import PASSWORD, USER, PostgresServer, postgres_server
from live_programs import program_path
from pages import page_parser, publish

CHANNELS, RATE_HZ, BLOCK = 6, 10_000.0, 10_000
HEAD = Head(tuple(f"channel_{number}" for number in range(CHANNELS)), ("m/s^2",) * CHANNELS, RATE_HZ, "version = 1\n")
SNAPSHOT = bytes(20_000)


class Way(NamedTuple):
    """A way of writing outputs to a folder, and a function that counts the rows there."""

    write: Callable[[Path, list[Output]], None]
    count: Callable[[Path], int]


def made(rows: int) -> list[Output]:
    """Return the outputs of a stream: random walks in white noise, with stamps in seconds since 1970."""
    rng, outputs = np.random.default_rng(3), []
    for first in range(0, rows, BLOCK):
        count = min(BLOCK, rows - first)
        clean = np.cumsum(rng.normal(0, 0.01, (count, CHANNELS)), axis=0)
        outputs.append(
            Output(
                first,
                1.7e9 + (first + np.arange(count)) / RATE_HZ,
                clean + rng.normal(0, 1, clean.shape),
                clean,
                np.full_like(clean, 0.1),
                np.zeros(clean.shape, np.int8),
            )
        )
    return outputs


def commit_all(sink: CheckpointSink, outputs: list[Output]) -> None:
    """Commit outputs one by one, as a stream does."""
    sink.last()
    sink.open(HEAD)
    for output in outputs:
        rows = output.first_row + len(output)
        sink.commit([output], Checkpoint(rows, f'{{"row": {rows}}}', SNAPSHOT, HEAD.recipe, "replay:made.parquet"))
    sink.close()


def by_parquet_sink(folder: Path, outputs: list[Output]) -> None:
    """Write files through the sink."""
    sink = ParquetSink(Address.parsed(f"parquet:{folder}"))
    sink.open(HEAD)
    for output in outputs:
        sink.write(output)
        sink.flush()
    sink.close()


def by_pyarrow(folder: Path, outputs: list[Output]) -> None:
    """Write one file with pyarrow."""
    path = folder / "plain.parquet"
    with pq.ParquetWriter(path, output_table(HEAD, outputs[:1]).schema) as writer:
        for output in outputs:
            writer.write_table(output_table(HEAD, [output]))
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def by_deltalake(folder: Path, outputs: list[Output]) -> None:
    """Append to a table with deltalake."""
    import deltalake

    for output in outputs:
        deltalake.write_deltalake(str(folder), output_table(HEAD, [output]), mode="append")


def in_files(folder: Path) -> int:
    """Count the rows of Parquet files."""
    return sum(pq.read_metadata(path).num_rows for path in folder.rglob("*.parquet"))


def in_delta(folder: Path) -> int:
    """Count the rows of a Delta table."""
    import deltalake

    return int(deltalake.DeltaTable(str(folder)).count())


def postgres_ways(server: PostgresServer) -> tuple[Way, Way]:
    """Return two ways of writing rows to a server: the sink and plain COPY."""
    address = f"postgres://{USER}@127.0.0.1:{server.port}/postgres?table="

    def by_sink(_: Path, outputs: list[Output]) -> None:
        forget("kept", "kept_checkpoint", "kept_losses")
        commit_all(PostgresSink(Address.parsed(f"{address}kept")), outputs)

    def by_copy(_: Path, outputs: list[Output]) -> None:
        forget("plain")
        binary = BinaryRows(CHANNELS)
        prepared = [b"".join([COPY_HEADER, *map(bytes, binary.encode(output)), COPY_TRAILER]) for output in outputs]
        with server.connect() as connection:
            connection.execute("CREATE TABLE plain (LIKE kept INCLUDING ALL)")
            columns = connection.execute("SELECT * FROM plain").description[:-1]  # the server generates the last one
            names = ", ".join(f'"{column.name}"' for column in columns)
            started[0] = time.perf_counter()
            for piece in prepared:
                copying = f"COPY plain ({names}) FROM STDIN (FORMAT BINARY)"
                with connection.transaction(), connection.cursor() as cursor, cursor.copy(copying) as copy:
                    copy.write(piece)

    def forget(*tables: str) -> None:
        server.do(f"DROP TABLE IF EXISTS {', '.join(tables)}; CHECKPOINT")
        started[0] = time.perf_counter()

    def count(table: str) -> Callable[[Path], int]:
        return lambda _: int(server.asked(f"SELECT count(*) FROM {table}")[0][0])

    return Way(by_sink, count("kept")), Way(by_copy, count("plain"))


started = [0.0]
"""Start of the measured time; a way of writing sets it again after its preparations."""


def seconds(way: Way, outputs: list[Output]) -> float:
    """Write all outputs once, check that all rows exist, and return the time in seconds."""
    with tempfile.TemporaryDirectory(prefix="becalm-sinks-") as folder:
        started[0] = time.perf_counter()
        way.write(Path(folder), outputs)
        took = time.perf_counter() - started[0]
        found, asked = way.count(Path(folder)), sum(map(len, outputs))
    if found != asked:
        raise SystemExit(f"{way.write.__name__} left {found} rows of {asked}.")
    return took


@contextmanager
def rivals() -> Iterator[list[tuple[str, Way, str, Way]]]:
    """Yield each sink with its rival."""
    delta = Way(lambda folder, outputs: commit_all(DeltaSink(Address.parsed(f"delta:{folder}")), outputs), in_delta)
    listed = [
        ("parquet", Way(by_parquet_sink, in_files), "pyarrow", Way(by_pyarrow, in_files)),
        ("delta", delta, "deltalake, rows only", Way(by_deltalake, in_delta)),
    ]
    if program_path("initdb") is None:
        yield listed
        return
    os.environ["PGPASSWORD"] = PASSWORD
    with postgres_server(fsync="on") as server:
        ours, theirs = postgres_ways(server)
        yield [*listed, ("postgres", ours, "bare COPY, rows only", theirs)]


def table(rows: int, repeats: int) -> str:
    """Return the page's table."""
    outputs = made(rows)
    lines = ["| sink | rows a second | beside | rows a second | of it |", "|---|---|---|---|---|"]
    with rivals() as pairs:
        for name, ours, rival, theirs in pairs:
            took = [(seconds(ours, outputs), seconds(theirs, outputs)) for _ in range(repeats)]
            best, other = (rows / min(times) for times in zip(*took, strict=True))
            lines.append(f"| {name} | {best:,.0f} | {rival} | {other:,.0f} | {best / other:.2f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, and write the page."""
    parser = page_parser(__doc__)
    parser.add_argument("--rows", type=int, default=500_000)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    text = table(arguments.rows, arguments.repeats)
    size = f"\n{arguments.rows:,} rows of {CHANNELS} channels: {4 * CHANNELS + 2} columns, raw and clean.\n"
    publish("How fast streams are kept", __doc__, text + size, arguments.output)


if __name__ == "__main__":
    main()
