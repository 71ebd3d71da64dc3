"""A file read in blocks is the file read whole; an output written in chunks is the output written whole."""

from __future__ import annotations

import gzip
import importlib.util
import os
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.core.time.clock import Clock
from becalm.core.time.timebase import Timebase
from becalm.errors import BecalmError, InputError, OutputError
from becalm.files import ReadOptions, SourceFile, open_source, read_source, roles, rows
from becalm.files.csv import blocks as csv_blocks

DATA = Path(__file__).parents[2].parent / "shared" / "data"


def sibling(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(__file__).parent / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


VARIANTS: dict[str, str] = sibling("test_csv_variants").VARIANTS
BAD: dict[str, tuple[bytes, str]] = sibling("test_bad_input").BAD


def lines(head: str, line: str, count: int, *more: str) -> str:
    """A table from a pattern: {i} counts, {t} is the time, {v} a value."""
    return head + "\n" + "".join(line.format(i=i, t=i / 8, v=f"{i % 3}.5") + "\n" for i in range(count)) + "".join(more)


LATE: dict[str, str] = {
    "decimal commas late": lines("time_s;a", "{i};7", 300, "300;2,25\n"),
    "long whole numbers": "t_ns,a\n" + "".join(f"{1_646_670_915_123_456_789 + 10**7 * i},{i % 3}\n" for i in range(99)),
    "long whole numbers behind commas": lines("time_s,a,id", "{t},{v},9007199254740{i:03d}", 300),
    "long whole numbers after zeros": lines("time_s,a,id", "{t},{v},0", 900, "200,1,1700000000123456789\n"),
    "long whole numbers after nothing": lines("time_s,a,id", "{t},{v},", 300, "200,1,1700000000123456789\n"),
    "decimal commas after nothing": lines("time_s;a;b", "{i};7;", 300, "300;2;2,25\n"),
    "quotes late": lines("time_s,a,n", "{t},{v},x", 99, '12.5,0.5,"a, b"\n', "12.625,0.5,y\n"),
    "line ends in cells": lines("time_s,a,n", '{t},{v},"x\ny"', 99),
    "words late": lines("time_s,a,b", "{t},{v},1.5", 300, "37.5,1,off\n", "37.625,1,2\n"),
    "blank end": lines("time_s,a", "{t},{v}", 400, ",\n" * 300),
    "dates": "Date,a\n" + "".join(f"{1 + i % 28:02d}/{1 + i // 28:02d}/2022,{i % 3}.5\n" for i in range(80)),
    "midnights": "Uhrzeit,a\n" + "".join(f"{(3 * i) % 24:02d}:00:00,{i % 3}.5\n" for i in range(80)),
    "two columns": "Datum;Zeit;a\n"
    + "".join(f"{7 + i // 24:02d}.03.2022;{i % 24:02d}:00:00;{i % 3}.5\n" for i in range(80)),
    "flags and counters": "time_s,n,f,a\n"
    + "".join(f"{i / 8},{i},{i % 2},{i % 2}\n" for i in range(300))
    + "37.5,7,1,3\n",
}


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Make every limit so small that a test's files are long ones."""
    monkeypatch.setattr(rows, "BLOCK_ROWS", 7)
    monkeypatch.setattr(rows, "MOST_MEMORY_ROWS", 0)
    monkeypatch.setattr(rows, "_SPOOL_BLOCK", 5)
    monkeypatch.setattr(roles, "_FIRST_ROWS", 3)
    monkeypatch.setattr(csv_blocks, "WHOLE_BYTES", 0)
    monkeypatch.setattr(csv_blocks, "BLOCK_BYTES", 900)
    return monkeypatch


def assert_same_table(one: pa.Table, other: pa.Table) -> None:
    assert one.schema.equals(other.schema, check_metadata=True)
    for mine, its in zip(one.columns, other.columns, strict=True):
        if pa.types.is_floating(mine.type):  # where NaN is NaN
            assert mine.null_count == its.null_count
            np.testing.assert_array_equal(mine.to_numpy(), its.to_numpy())
        else:
            assert mine.equals(its)


def read_or_refused(path: Path, options: ReadOptions | None = None) -> SourceFile | str:
    try:
        return read_source(path, options)
    except BecalmError as cause:
        return str(cause)


def assert_same(one: SourceFile | str, other: SourceFile | str) -> None:
    if isinstance(one, str) or isinstance(other, str):
        assert one == other
        return
    assert one.layout.columns == other.layout.columns
    assert one.layout.time_columns == other.layout.time_columns
    for fact, told in one.layout.as_dict().items():
        same = pytest.approx(told, rel=1e-9, abs=1e-12) if isinstance(told, float) else told
        assert other.layout.as_dict()[fact] == same
    assert_same_table(one.table, other.table)
    assert one.recording.names == other.recording.names
    np.testing.assert_array_equal(one.recording.samples, other.recording.samples)
    np.testing.assert_allclose(one.recording.timebase.elapsed_steps, other.recording.timebase.elapsed_steps, rtol=1e-12)


@pytest.mark.parametrize("packed", [False, True], ids=["plain", "gzip"])
@pytest.mark.parametrize("text", [*VARIANTS.values(), *LATE.values()], ids=[*VARIANTS, *LATE])
def test_csv_in_blocks_is_csv_whole(text: str, packed: bool, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(gzip.compress(text.encode()) if packed else text.encode())
    whole = read_or_refused(path)
    request.getfixturevalue("small_blocks")
    assert_same(read_or_refused(path), whole)


@pytest.mark.parametrize(
    ("case", "column", "last"),
    [
        ("long whole numbers after zeros", "id", 1_700_000_000_123_456_789),
        ("long whole numbers after nothing", "id", 1_700_000_000_123_456_789),
        ("decimal commas after nothing", "b", 2.25),
    ],
)
def test_what_the_first_rows_do_not_show_is_read_exactly(case: str, column: str, last: float, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(LATE[case], encoding="utf-8")
    assert read_source(path).table.column(column)[-1].as_py() == last


@pytest.mark.parametrize("codec", ["utf-8-sig", "utf-16", "cp1252", "utf-16-be"])
def test_encodings_in_blocks(codec: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    text = "time_s,Dehnung (µm/m),n\n" + "".join(f"{i / 8},{i % 3}.5,ä{'é' * (i % 3)}\n" for i in range(300))
    path = tmp_path / "log.csv"
    path.write_bytes(("\ufeff" + text if codec == "utf-16-be" else text).encode(codec))
    whole = read_or_refused(path)
    assert isinstance(whole, SourceFile)
    small = request.getfixturevalue("small_blocks")
    assert_same(read_or_refused(path), whole)
    small.setattr(csv_blocks, "BLOCK_BYTES", 1001)
    assert_same(read_or_refused(path), whole)


@pytest.mark.parametrize("data", [data for data, _ in BAD.values()], ids=BAD.keys())
def test_what_is_refused_whole_is_refused_in_blocks(
    data: bytes, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(data)
    whole = read_or_refused(path)
    request.getfixturevalue("small_blocks")
    assert isinstance(whole, str)
    assert_same(read_or_refused(path), whole)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("comma2k19/accelerometer.csv", None),
        ("fusion/sensor_data.csv", None),
        ("munich_bridge/support_load_strain.csv.gz", None),
        ("imu_tk/xsens_acc.mat.txt.gz", None),
        ("gaitmap/imu_sample.csv", ReadOptions(rate_hz=204.8)),
    ],
)
def test_real_files_in_blocks(
    name: str, options: ReadOptions | None, small_blocks: pytest.MonkeyPatch, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"the recordings are not beside the project ({name})")
    small_blocks.setattr(rows, "BLOCK_ROWS", 997)
    small_blocks.setattr(csv_blocks, "BLOCK_BYTES", 100_003)
    in_blocks = read_or_refused(path, options)
    monkeypatch.undo()
    assert_same(in_blocks, read_or_refused(path, options))


def odd_table() -> pa.Table:
    count = 1003
    rng = np.random.default_rng(8)
    return pa.table(
        {
            "time": pa.array(np.arange(count) * 10_000_000 + 1_646_670_915 * 10**9, pa.timestamp("ns")),
            "a": rng.normal(size=count),
            "a.b": pa.array(rng.normal(size=count), mask=rng.random(count) < 0.1),
            "n": pa.array(rng.integers(0, 9, count), pa.int16()),
            "on": pa.array(rng.random(count) < 0.5),
            "words": pa.array([f"w{i % 3}" for i in range(count)]).dictionary_encode(),
            "list": pa.array([[i] for i in range(count)]),
        }
    )


@pytest.mark.parametrize("size", [1, 7, 1000, 1003, 5000, None])
def test_chunks_put_together_are_the_file(size: int | None, tmp_path: Path) -> None:
    pq.write_table(odd_table(), tmp_path / "in.parquet", row_group_size=100)
    whole = read_source(tmp_path / "in.parquet")
    with open_source(tmp_path / "in.parquet") as source:
        chunks = list(source.chunks(size))
        assert source.names == whole.recording.names == ("a", "a.b", "n")
        assert source.units == whole.recording.units
        assert source.layout == whole.layout
    assert [chunk.first_row for chunk in chunks] == list(range(0, 1003, size or 1003))
    assert {len(chunk) for chunk in chunks[:-1]} <= {size}
    assert pa.concat_tables([chunk.table for chunk in chunks]).equals(whole.table)
    np.testing.assert_array_equal(np.concatenate([chunk.samples for chunk in chunks]), whole.recording.samples)
    elapsed = np.concatenate([chunk.elapsed_steps for chunk in chunks])
    np.testing.assert_array_equal(elapsed, whole.recording.timebase.elapsed_steps)


def stamps(kind: str) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(5)
    even = np.arange(5000) / 97.0
    return {
        "even": even,
        "rounded": np.round(even, 3),
        "gaps": np.delete(even, [7, 8, 2000]),
        "jitter": even + 1e-4 * rng.normal(size=5000),
        "repeats": np.sort(np.round(even + rng.normal(size=5000) / 97, 2)),
    }[kind]


@pytest.mark.parametrize("kind", ["even", "rounded", "gaps", "jitter", "repeats"])
@pytest.mark.parametrize("size", [1, 7, 1000])
def test_a_clock_understood_in_blocks(kind: str, size: int) -> None:
    times = stamps(kind)
    whole = Timebase.from_stamps(times)
    starts = range(0, len(times), size)
    clock = Clock.from_stamps(len(times), lambda: (times[start : start + size] for start in starts))
    assert (clock.uniform, clock.step_s, clock.start_s) == (whole.uniform, whole.step_s, whole.start_s)
    assert clock.jitter_s == pytest.approx(whole.jitter_s, rel=1e-6, abs=1e-12)
    assert clock.duration_s == pytest.approx(whole.duration_s, rel=1e-12)
    assert (clock.gaps, clock.repeats) == (len(whole.gaps), len(whole.repeats))
    parts = [clock.elapsed(times[s : s + size], times[s - 1] if s else None) for s in starts]
    np.testing.assert_array_equal(np.concatenate(parts), whole.elapsed_steps)


@pytest.mark.parametrize("kind", ["even", "gaps", "jitter"])
@pytest.mark.parametrize("rate", [None, 50.0])
def test_a_sample_keeps_the_time_between_its_stretches(kind: str, rate: float | None, tmp_path: Path) -> None:
    times = stamps(kind)
    pq.write_table(pa.table({"time_s": times, "a": np.sin(times)}), tmp_path / "in.parquet", row_group_size=333)
    with open_source(tmp_path / "in.parquet", ReadOptions(rate_hz=rate)) as source:
        whole, some = source.recording(), source.sample(800)
        assert len(source.sample(5000)) == len(whole)
        assert len(source.sample(3)) == 3
    assert len(some) == 800
    assert some.rate_hz == whole.rate_hz
    where = np.searchsorted(whole.times_s, some.times_s - 1e-6)
    np.testing.assert_allclose(some.times_s, whole.times_s[where], atol=1e-6)
    np.testing.assert_array_equal(some.samples, whole.samples[where])
    assert np.count_nonzero(some.timebase.elapsed_steps > 50) == 7


def test_damage_in_the_middle_is_told_while_reading(tmp_path: Path) -> None:
    path = tmp_path / "in.parquet"
    table = pa.table({"time_s": np.arange(90_000) / 100, "a": np.random.default_rng(1).normal(size=90_000)})
    pq.write_table(table, path, row_group_size=30_000, use_dictionary=False)
    column = pq.ParquetFile(path).metadata.row_group(1).column(1)
    data = bytearray(path.read_bytes())
    data[column.data_page_offset : column.data_page_offset + 2000] = b"\xff" * 2000
    path.write_bytes(bytes(data))
    with open_source(path, ReadOptions(channels=("a",))) as source:
        with pytest.raises(InputError, match="damaged Parquet") as refusal:
            list(source.chunks(1000))
        assert str(refusal.value).count(str(path)) == 1
    with pytest.raises(InputError, match="damaged Parquet"):
        read_source(path)


def test_a_full_temporary_folder_is_told(tmp_path: Path, small_blocks: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.csv").write_text(VARIANTS["plain"])

    def full(**_: object) -> None:
        raise OSError(28, os.strerror(28))

    small_blocks.setattr(rows.tempfile, "TemporaryFile", full)  # type: ignore[attr-defined]
    with pytest.raises(OutputError, match="TMPDIR=FOLDER"):
        read_source(tmp_path / "log.csv")
