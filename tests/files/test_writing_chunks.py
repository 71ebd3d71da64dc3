"""An output written in chunks is the output written whole, or nothing; memory does not grow with the file."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.errors import InputError, OutputError
from becalm.files import CleanChannel, open_output, open_source, output_block, output_table, read_source, write_table
from peak_memory import peak_mb


def table_of(count: int = 1003) -> pa.Table:
    rng = np.random.default_rng(8)
    epoch = 1_700_000_000_000.0 + 10.0 * np.arange(count)
    fifth = np.arange(count) % 5
    return pa.table(
        {
            "time": pa.array(np.arange(count) * 10_000_000 + 1_646_670_915 * 10**9, pa.timestamp("ns")),
            "a": rng.normal(size=count),
            "a.b": pa.array(rng.normal(size=count), mask=rng.random(count) < 0.1),
            "n": pa.array(rng.integers(0, 9, count), pa.int16()),
            "on": pa.array(rng.random(count) < 0.5),
            "words": [f"w{i % 3}" for i in range(count)],
            "long": epoch,
            "note": ['say "x, y"' if i == 500 else "" if i % 2 else "ok" for i in range(count)],
            "mixed": pa.array(np.where(fifth == 0, epoch, 0.5), mask=fifth == 1),
            "none": pa.nulls(count),
        }
    )


def written(folder: Path, name: str, table: pa.Table, size: int) -> Path:
    with open_output(folder / name, {"becalm.recipe": "r"}) as out:
        for start in range(0, table.num_rows, size):
            out.write(table.slice(start, size))
    return folder / name


@pytest.mark.parametrize("size", [1, 7, 1000])
@pytest.mark.parametrize("ending", ["csv", "csv.gz", "parquet"])
def test_written_in_chunks_is_written_whole(ending: str, size: int, tmp_path: Path) -> None:
    table = table_of()
    write_table(tmp_path / f"whole.{ending}", table, {"becalm.recipe": "r"})
    path = written(tmp_path, f"chunks.{ending}", table, size)
    if ending == "parquet":
        assert pq.read_table(path).equals(pq.read_table(tmp_path / "whole.parquet"))
        assert pq.read_schema(path).metadata[b"becalm.recipe"] == b"r"
        assert pq.ParquetFile(path).num_row_groups == 1
    else:
        assert path.read_bytes() == (tmp_path / f"whole.{ending}").read_bytes()
        text = gzip.decompress(path.read_bytes()) if ending == "csv.gz" else path.read_bytes()
        assert text.count(b"e+") == 0
        assert text.splitlines()[501].count(b'"') == 6  # one cell, its own marks doubled
        assert text.splitlines()[500].count(b'"') == 0


def test_output_chunks_are_the_output_table(tmp_path: Path) -> None:
    pq.write_table(table_of(), tmp_path / "in.parquet")
    whole = read_source(tmp_path / "in.parquet")
    expected = output_table(whole, whole.recording, whole.recording.with_samples(whole.recording.samples / 3))
    with open_source(tmp_path / "in.parquet") as source:
        parts = [
            output_block(
                chunk.table,
                {
                    name: CleanChannel(chunk.channel(i), chunk.channel(i) / 3, source.units[i])
                    for i, name in enumerate(source.names)
                },
            )
            for chunk in source.chunks(100)
        ]
    assert all(part.schema.equals(expected.schema, check_metadata=True) for part in parts)
    write_table(tmp_path / "chunks.csv", pa.concat_tables(parts).drop_columns(["none"]))
    write_table(tmp_path / "whole.csv", expected.drop_columns(["none"]))
    assert (tmp_path / "chunks.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


@pytest.mark.parametrize("stop", [KeyboardInterrupt, RuntimeError, InputError])
@pytest.mark.parametrize("ending", ["csv", "csv.gz", "parquet"])
def test_what_stops_half_way_leaves_nothing(stop: type[BaseException], ending: str, tmp_path: Path) -> None:
    table = pa.table({"a": np.arange(1000.0)})

    def stop_half_way() -> None:
        with open_output(tmp_path / f"o.{ending}") as out:
            for _ in range(5):
                out.write(table)
            raise stop

    with pytest.raises(stop):
        stop_half_way()
    assert list(tmp_path.iterdir()) == []


def test_a_failure_while_writing_reaches_the_one_who_hands_over(tmp_path: Path) -> None:
    def hand_over_many() -> None:
        with open_output(tmp_path / "o.csv") as out:
            for _ in range(100):
                out.write(pa.table({"l": [[1.0]]}))

    with pytest.raises(OutputError, match=r"write \.parquet"):
        hand_over_many()
    assert list(tmp_path.iterdir()) == []


MEASURED = """
import sys
from becalm.files import CleanChannel, open_output, open_source, output_block
with open_source(sys.argv[1]) as source, open_output(sys.argv[2]) as out:
    for chunk in source.chunks():
        own = {n: CleanChannel(chunk.channel(i), chunk.channel(i)) for i, n in enumerate(source.names)}
        out.write(output_block(chunk.table, own))
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    noise, peaks = np.random.default_rng(2).normal(size=(4, 1_000_000)), []
    for millions in (4, 8):
        schema = pa.schema([(name, pa.float64()) for name in ("time_s", "a", "b", "c", "d")])
        with pq.ParquetWriter(tmp_path / "in.parquet", schema) as writer:
            for part in range(millions):
                time = np.arange(part * 1_000_000, (part + 1) * 1_000_000) / 1000
                writer.write_table(pa.table([time, *noise], schema=schema))
        peaks.append(peak_mb(MEASURED, tmp_path / "in.parquet", tmp_path / "out.parquet"))
        assert pq.ParquetFile(tmp_path / "out.parquet").metadata.num_rows == millions * 1_000_000
    assert peaks[1] < peaks[0] + 150  # MB; all of the further rows would be 290
    assert peaks[1] < 800, peaks
