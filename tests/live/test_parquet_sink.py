"""parquet: hours as files that are whole."""

from __future__ import annotations

import errno
import logging
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread
from typing import Any

import duckdb
import numpy as np
import pandas
import polars
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.errors import OutputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Head, Output
from becalm.live.protocols import Sink, StorageFullError
from becalm.live.sinks import parquet_part
from becalm.live.sinks.parquet import ParquetSink
from becalm.live.tables import output_table
from streams import assert_same_bits, head_of, outputs_of

HOUR_S = 1.7e9 // 3600 * 3600


def sink_of(folder: Path, options: str = "", head: Head | None = None) -> ParquetSink:
    """Return a sink that is ready."""
    sink = ParquetSink(Address.parsed(f"parquet:{folder}{options}"))
    sink.open(head or head_of("a", "b"))
    return sink


def names_in(folder: Path) -> list[str]:
    """Return the files in a folder and below it."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.suffix == ".parquet")


def read(folder: Path) -> pa.Table:
    """Return the rows of all whole files."""
    return pa.concat_tables([pq.read_table(path) for path in sorted(folder.rglob("*.parquet"))]).sort_by("row")


def test_hours_close_at_their_row(tmp_path: Path) -> None:
    sink, head = sink_of(tmp_path), head_of("a", "b")
    assert isinstance(sink, Sink)
    outputs = outputs_of([1000, 0, 5000, 1], channels=2, begins_s=HOUR_S - 2.0)
    for output in outputs:
        sink.write(output)
    sink.flush()
    assert names_in(tmp_path) == ["2023-11-14/21.parquet"]
    sink.close()
    sink.close()
    assert names_in(tmp_path) == ["2023-11-14/21.parquet", "2023-11-14/22.parquet"]
    assert pq.read_table(tmp_path / "2023-11-14" / "21.parquet").num_rows == 2000
    written, found = output_table(head, outputs), read(tmp_path)
    assert found.schema.equals(written.schema, check_metadata=True)
    assert_same_bits(found, written)


def test_duckdb_polars_and_pandas_read_them(tmp_path: Path) -> None:
    sink = sink_of(tmp_path, "?rows=40")
    for output in outputs_of([33, 33, 34], channels=2):
        sink.write(output)
    sink.close()
    assert names_in(tmp_path) == [f"rows-{row:012}.parquet" for row in (0, 40, 80)]
    files = f"{tmp_path}/*.parquet"
    with duckdb.connect() as reader:
        query = f"select count(*), max(row), any_value(a_verdict order by row) from '{files}'"
        assert reader.execute(query).fetchall() == [(100, 99, "used")]
    frame = polars.read_parquet(files)
    assert frame["row"].to_list() == list(range(100))
    assert frame["a_verdict"].to_list()[:3] == ["used", "missing", "spike"]
    assert len(pandas.read_parquet(tmp_path)) == 100


@settings(max_examples=25)
@given(
    sizes=st.lists(st.integers(0, 40), max_size=6),
    most=st.sampled_from(["", "?rows=9", "?rows=17"]),
    flushes=st.booleans(),
    jumps=st.lists(st.sampled_from([0.0, 1.0, 4000.0, -4000.0, -1.7e9, 1e12, np.nan, 1e300]), min_size=6, max_size=6),
)
def test_every_row_is_there_once_whatever_the_clock_does(
    tmp_path_factory: pytest.TempPathFactory, sizes: list[int], most: str, flushes: bool, jumps: list[float]
) -> None:
    folder = tmp_path_factory.mktemp("clock")
    sink, stamp, row = sink_of(folder, most), 1.7e9, 0
    stamps: list[float] = []
    for size, jump in zip(sizes, jumps, strict=False):
        stamp = stamp + jump if np.isfinite(stamp + jump) and abs(stamp + jump) < 1e15 else stamp
        (output,) = outputs_of([size], channels=2, first_row=row, begins_s=stamp)
        if size and not np.isfinite(jump):
            output.time_s[size // 2] = jump
        sink.write(output)
        if flushes:
            sink.flush()
        stamps += output.time_s.tolist()
        row += size
    sink.close()
    if row:
        found = read(folder)
        assert found["row"].to_pylist() == list(range(row))
        np.testing.assert_array_equal(found["time_s"].to_numpy(), stamps)


def test_a_clock_that_jumps_far_ahead_keeps_no_file_open_for_ever(tmp_path: Path) -> None:
    """The hour it jumped to never ends; two hours' rows do."""
    sink = sink_of(tmp_path, head=Head(("a",), ("m",), 0.01, ""))  # 36 readings an hour
    (ahead,), after = outputs_of([1], begins_s=4e9), outputs_of([72] * 3, first_row=1, begins_s=1.7e9)
    for output in (ahead, *after):
        sink.write(output)
    sink.flush()
    assert len([name for name in names_in(tmp_path) if name.endswith(".parquet")]) == 3
    sink.close()
    assert read(tmp_path)["row"].to_pylist() == list(range(217))


def test_one_thread_writes_while_another_flushes(tmp_path: Path) -> None:
    sink, done = sink_of(tmp_path, "?rows=1000"), Event()

    def flushing() -> None:
        while not done.is_set():
            sink.flush()

    flusher = Thread(target=flushing)
    flusher.start()
    for output in outputs_of([7] * 2000, channels=2):
        sink.write(output)
    done.set()
    flusher.join()
    sink.close()
    assert read(tmp_path)["row"].to_pylist() == list(range(14_000))


def test_a_name_that_is_taken_is_not_written_over(tmp_path: Path) -> None:
    for first_row in (0, 10):
        sink = sink_of(tmp_path)
        sink.write(outputs_of([10], channels=2, first_row=first_row, begins_s=HOUR_S)[0])
        sink.close()
    assert names_in(tmp_path) == ["2023-11-14/22.parquet", "2023-11-14/22_02.parquet"]
    assert read(tmp_path)["row"].to_pylist() == list(range(20))


def many(rows: int, first_row: int) -> Output:
    """Return so many rows at once that they go to the disk."""
    return outputs_of([rows], channels=2, first_row=first_row, begins_s=HOUR_S)[0]


def test_what_a_killed_process_left_is_put_aside(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    script = tmp_path / "writes.py"
    script.write_text(
        "import os, sys\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from streams import head_of, outputs_of\n"
        "from becalm.live.address import Address\n"
        "from becalm.live.sinks.parquet import ParquetSink\n"
        "sink = ParquetSink(Address.parsed('parquet:' + sys.argv[1]))\n"
        "sink.open(head_of('a', 'b'))\n"
        f"sink.write(outputs_of([1 << 20], channels=2, begins_s={HOUR_S})[0])\n"
        "sink.flush()\n"
        "os._exit(7)\n",
        encoding="utf-8",
    )
    folder = tmp_path / "kept"
    assert subprocess.run([sys.executable, script, folder], check=False).returncode == 7
    left = folder / "2023-11-14" / ".22.parquet.part"
    assert left.stat().st_size > 0
    left.with_name(f"{left.name}-left-1").touch()  # of a kill before
    with caplog.at_level(logging.WARNING):
        sink = sink_of(folder)
    assert "was incomplete" in caplog.text
    assert sorted(path.name for path in left.parent.iterdir()) == [f"{left.name}-left-{turn}" for turn in (1, 2)]
    sink.write(many(10, 0))
    sink.close()
    assert read(folder).num_rows == 10


def test_the_second_writer_is_refused(tmp_path: Path) -> None:
    first = sink_of(tmp_path)
    with pytest.raises(UsageError, match="Another process"):
        sink_of(tmp_path)
    first.close()
    sink_of(tmp_path).close()


def test_a_full_disk_loses_no_row_when_there_is_room_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk takes some bytes, then none, then all again."""
    sink, room = sink_of(tmp_path), [100]
    opened = Path.open

    class Short:
        def __init__(self, file: Any) -> None:
            self._file = file

        def __enter__(self) -> Short:
            return self

        def __exit__(self, *_: object) -> None:
            self._file.close()

        def __getattr__(self, name: str) -> Any:
            return getattr(self._file, name)

        def write(self, content: memoryview) -> int:
            if room[0] == 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            done: int = self._file.write(content[: room[0]])
            room[0] -= done
            return done

    with monkeypatch.context() as patched:
        patched.setattr(Path, "open", lambda path, *words, **options: Short(opened(path, *words, **options)))
        sink.write(many(1 << 20, 0))
        sink.write(replace(many(10, 1 << 20), time_s=np.full(10, HOUR_S + 3600.0)))
        for _ in range(3):
            with pytest.raises(StorageFullError, match="cannot be written now"):
                sink.flush()
        room[0] = 1 << 30
        sink.flush()
        room[0] = 0
        for _ in range(2):
            with pytest.raises(StorageFullError):
                sink.close()
        room[0] = 1 << 30
        sink.close()
    assert names_in(tmp_path) == ["2023-11-14/22.parquet", "2023-11-14/23.parquet"]
    assert read(tmp_path)["row"].to_numpy().tolist() == list(range((1 << 20) + 10))


def test_a_file_that_has_its_name_is_finished_after_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sink = sink_of(tmp_path)
    for output in outputs_of([1000, 5000], channels=2, begins_s=HOUR_S - 2.0):
        sink.write(output)

    def fail(_: Path) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with monkeypatch.context() as patched:
        patched.setattr(parquet_part, "sync_folder", fail)
        with pytest.raises(StorageFullError, match="cannot be written now"):
            sink.close()
    sink.close()
    assert read(tmp_path)["row"].to_pylist() == list(range(6000))


def test_a_folder_that_is_none_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(OutputError, match="choose another folder"):
        sink_of(tmp_path / "file" / "below")


@pytest.mark.parametrize("address", ["parquet:", "parquet:d?hours=1", "parquet:d?rows=0", "parquet:d?rows=x"])
def test_addresses_that_cannot_be_meant_are_refused(address: str) -> None:
    with pytest.raises(UsageError):
        ParquetSink(Address.parsed(address))


def test_channels_whose_columns_would_be_one_are_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="would be called"):
        sink_of(tmp_path, head=head_of("a", "a_raw"))
