"""A folder of Parquet files is one recording, in the order of time, whatever its files are called."""

from __future__ import annotations

import hashlib
import os
import pickle
from decimal import Decimal
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import becalm
from becalm.errors import InputError, TimeError
from becalm.files import ReadOptions, open_source, read_source
from becalm.files.lake.folder import FolderRows, read_folder
from lakes import START_MS, cut, evenly, readings

COUNT = 300
MS = np.arange(COUNT) * 10 + (np.arange(COUNT) >= 120) * 500  # with a gap
STAMPS = (START_MS + MS).astype("datetime64[ms]")
TEXTS = [str(stamp) for stamp in STAMPS]

TIMES: dict[str, dict[str, Any]] = {
    "seconds": {"time_s": MS / 1e3},
    "milliseconds": {"time (ms)": MS},
    "decimal": {"time": pa.array([Decimal(int(ms)) / 1000 for ms in MS])},
    "float32": {"t": (MS / 1e3).astype(np.float32)},
    "epoch in ns": {"timestamp": (START_MS + MS) * 1_000_000},
    "timestamps": {"when": pa.array(STAMPS.astype("datetime64[us]"))},
    "in a zone": {"when": pa.array((START_MS + MS) * 1000, pa.timestamp("us", "Europe/Berlin"))},
    "text": {"time": TEXTS},
    "text in a dictionary": {"time": pa.array([text.replace("T", " ") for text in TEXTS]).dictionary_encode()},
    "day first": {"Zeit": [f"{text[8:10]}.{text[5:7]}.{text[:4]} {text[11:]}" for text in TEXTS]},
    "date and time of day": {"Date": [text[:10] for text in TEXTS], "Time": [text[11:] for text in TEXTS]},
    "unnamed": {"x": MS / 1e3},
}


def same(folder: Path, file: Path, **said: Any) -> None:
    """Compare what is read of a folder with what is read of a file, to the bit."""
    options = ReadOptions(**said)
    found, wanted = read_source(folder, options), read_source(file, options)
    assert found.recording.samples.tobytes() == wanted.recording.samples.tobytes()
    assert found.recording.times_s.tobytes() == wanted.recording.times_s.tobytes()
    assert found.recording.units == wanted.recording.units
    assert found.layout == wanted.layout
    assert found.table.schema.equals(wanted.table.schema, check_metadata=True)
    assert [repr(row) for row in found.table.to_pylist()] == [repr(row) for row in wanted.table.to_pylist()]


@pytest.mark.parametrize("time", TIMES.values(), ids=TIMES.keys())
def test_files_are_read_in_the_order_of_time(time: dict[str, Any], tmp_path: Path) -> None:
    table = pa.table({**time, **readings()})
    cut(table, [50, 51, 210], ["c.parquet", "a.parquet", "d.parquet", "b.parquet"], tmp_path / "lake")
    cut(table, [], ["whole.parquet"], tmp_path)
    same(tmp_path / "lake", tmp_path / "whole.parquet")


NAMES = st.text("abz019-_ é", min_size=1, max_size=4).map(lambda name: f"x{name}.parquet")
PLACES = st.sampled_from(["", "date=2026-01-02/", "date=2026-01-10/hour=3/", "2026/"])


@settings(max_examples=40)
@given(
    time=st.sampled_from(sorted(TIMES)),
    names=st.lists(st.tuples(PLACES, NAMES).map("".join), min_size=1, max_size=6, unique_by=str.lower),
    data=st.data(),
)
def test_any_cut_reads_as_the_table(time: str, names: list[str], data: st.DataObject) -> None:
    least = 3 if time == "unnamed" else 0  # a column without a name of time must be seen to rise
    ends = data.draw(
        st.lists(st.integers(least, COUNT - least), min_size=len(names) - 1, max_size=len(names) - 1).map(sorted)
    )
    table = pa.table({**TIMES[time], **readings()})
    with TemporaryDirectory() as place:
        cut(table, ends, names, Path(place) / "lake")
        cut(table, [], ["whole.parquet"], Path(place))
        same(Path(place) / "lake", Path(place) / "whole.parquet")


def test_where_nothing_tells_the_time_numbers_in_names_do(tmp_path: Path) -> None:
    table = pa.table(readings())
    names = [f"part-{number}.parquet" for number in (0, 2, 9, 10, 11)]
    cut(table, [20, 90, 91, 200], names, tmp_path / "lake")
    cut(table, [], ["whole.parquet"], tmp_path)
    same(tmp_path / "lake", tmp_path / "whole.parquet", rate_hz=50.0)


@pytest.mark.parametrize("temporal", [False, True])
def test_the_time_of_day_alone_starts_again_at_midnight(temporal: bool, tmp_path: Path) -> None:
    ticks = pa.array((START_MS + MS) % 86_400_000, pa.int32()).cast(pa.time32("ms"))
    table = pa.table({"time": ticks if temporal else [text[11:] for text in TEXTS], **readings()})
    cut(table, [60, 110, 200], [f"date=2022-03-{day}/log.parquet" for day in (7, 8, 9, 10)], tmp_path / "lake")
    cut(table, [], ["whole.parquet"], tmp_path)
    same(tmp_path / "lake", tmp_path / "whole.parquet")


@pytest.mark.parametrize("end", [128, 250], ids=["between two files", "in one of them"])
def test_a_counter_that_wraps_is_read_in_the_order_of_names(end: int, tmp_path: Path) -> None:
    ticks = (2**32 - 1280 + np.arange(COUNT) * 10) % 2**32
    table = pa.table({"time (ms)": ticks, **readings()})
    cut(table, [60, end], ["part-8.parquet", "part-9.parquet", "part-10.parquet"], tmp_path / "lake")
    cut(table, [], ["whole.parquet"], tmp_path)
    same(tmp_path / "lake", tmp_path / "whole.parquet")
    assert becalm.read(tmp_path / "lake").timebase.duration_s == pytest.approx(2.99)


def test_stamps_that_are_missing_at_the_start_do_not_hide_the_order(tmp_path: Path) -> None:
    table = evenly()
    seconds = table["time_s"].to_numpy().copy()
    seconds[:2] = np.nan
    table = table.set_column(0, "time_s", pa.array(seconds))
    cut(table, [100], ["b.parquet", "a.parquet"], tmp_path / "lake")
    cut(table, [], ["whole.parquet"], tmp_path)
    same(tmp_path / "lake", tmp_path / "whole.parquet", rate_hz=100.0)


def test_columns_in_another_order_are_taken_by_name(tmp_path: Path) -> None:
    table = evenly()
    folder = cut(table, [100], ["a.parquet", "b.parquet"], tmp_path / "lake")
    mixed = table.slice(100).select(["words", "holed", "time_s", "walk"])
    words = mixed["words"].combine_chunks().dictionary_encode()
    pq.write_table(mixed.set_column(0, "words", words), folder / "b.parquet")
    cut(table, [], ["whole.parquet"], tmp_path)
    same(folder, tmp_path / "whole.parquet")


def test_what_columns_may_hold_is_that_of_all_files_and_the_rest_of_the_first(tmp_path: Path) -> None:
    folder = cut(evenly(), [100], ["b.parquet", "a.parquet"], tmp_path)
    unit = {"unit": "g"}
    for name, told, nullable in (("b", {"first": "yes"}, False), ("a", {"first": "no"}, True)):
        table = pq.read_table(folder / f"{name}.parquet").select(["time_s", "holed", "walk"])
        fields = [field.with_metadata(unit | told) for field in table.schema]
        fields[0] = fields[0].with_metadata(told)
        fields[2] = fields[2].with_nullable(nullable)
        pq.write_table(table.cast(pa.schema(fields, told)), folder / f"{name}.parquet")
    table = read_source(folder).table
    assert table.schema.field("walk").nullable
    assert table.schema.field("walk").metadata == {b"unit": b"g", b"first": b"yes"}
    assert all(one.schema.metadata[b"first"] == b"yes" for one in read_folder(folder).blocks(["walk"], most_rows=70))


def test_what_is_hidden_and_what_is_no_parquet_is_not_read(tmp_path: Path) -> None:
    names = ["b.parquet", "a", "_temporary/0/t.parquet", ".c.parquet.part", "_d.parquet", ".e/f.parquet"]
    folder = cut(evenly(), [50, 100, 150, 200, 250], names, tmp_path)
    (folder / "a.csv").write_text("time_s,a\n0,1\n1,2\n", encoding="utf-8")
    (folder / "nothing.txt").write_text("", encoding="utf-8")
    (folder / "empty").mkdir()
    assert len(becalm.read(folder)) == 100


def test_what_is_no_file_is_not_opened(tmp_path: Path) -> None:
    """A pipe that nobody writes to would be waited for."""
    folder = cut(evenly(), [], ["a.parquet"], tmp_path)
    for name in ("pipe", "pipe.parquet"):
        os.mkfifo(folder / name)
    (folder / "loop").symlink_to(folder / "loop")
    assert len(becalm.read(folder)) == COUNT


def test_files_without_rows_are_left_out(tmp_path: Path) -> None:
    folder = cut(evenly(), [0, 100, 100], ["c.parquet", "b.parquet", "d.parquet", "a.parquet"], tmp_path)
    pq.write_table(pa.table({"other": pa.array([], pa.int8())}), folder / "e.parquet")
    rows = read_folder(folder).rows
    assert isinstance(rows, FolderRows)
    assert rows.pieces == ((folder / "b.parquet", 100), (folder / "a.parquet", 200))
    for path in (folder / "a.parquet", folder / "b.parquet"):
        path.unlink()
    with pytest.raises(InputError, match="It has columns but no rows"):
        becalm.read(folder)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (
            ["sensor=2/a.parquet", "sensor=10/b.parquet"],
            r"sensor=2, sensor=10; .*clean \S+/sensor=2 .*fleet clean \S+ -o",
        ),
        (["k=1/s=a/a.parquet", "k=1/s=b/b.parquet"], r"k=1/s=a, k=1/s=b; .*clean \S+/k=1/s=a -o"),
        (["date=3/s=a b/a.parquet", "date=4/s=c/b.parquet"], r"s=a b, s=c; .*clean '\S+/date=3/s=a b' -o"),
        (["b.parquet", "s=1/a.parquet"], r"files of none, s=1; .*clean \S+/s=1 -o"),
    ],
)
def test_several_sensors_are_refused(names: list[str], said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"lake holds several sensors: {said}"):
        becalm.read(cut(evenly(), [100], names, tmp_path / "lake"))


def test_many_sensors_are_counted_and_one_is_read(tmp_path: Path) -> None:
    names = [f"sensor={number}/date={day}/log.parquet" for number in range(4) for day in (1, 2)]
    folder = cut(evenly(), range(10, 80, 10), names, tmp_path / "lake")
    with pytest.raises(InputError, match="sensor=0, sensor=1 and 2 more"):
        becalm.read(folder)
    assert len(becalm.read(folder / "sensor=2")) == 20


OTHERS = {
    "a column less": (lambda t: t.drop_columns(["holed"]), "b.parquet lacks the column 'holed' that .*a.parquet has"),
    "a column more": (lambda t: t.append_column("more", t["walk"]), "b.parquet has a column 'more' that .*a.parquet"),
    "another type": (
        lambda t: t.set_column(1, "walk", t["walk"].cast(pa.float32())),
        "b.parquet holds 'walk' as float, and .*a.parquet as double",
    ),
    "another unit": (
        lambda t: t.cast(t.schema.set(1, t.schema.field("walk").with_metadata({"unit": "g"}))),
        r"b.parquet has 'walk' in g, and .*a.parquet in no unit",
    ),
}


@pytest.mark.parametrize(("change", "said"), OTHERS.values(), ids=OTHERS.keys())
def test_files_of_other_columns_are_refused(change: Any, said: str, tmp_path: Path) -> None:
    folder = cut(evenly(), [100], ["a.parquet", "b.parquet"], tmp_path)
    pq.write_table(change(pq.read_table(folder / "b.parquet")), folder / "b.parquet")
    with pytest.raises(InputError, match=f"{said}.*the same columns"):
        becalm.read(folder)


def test_files_that_overlap_are_refused_and_the_files_are_told(tmp_path: Path) -> None:
    folder = cut(evenly(), [100], ["x.parquet", "y.parquet"], tmp_path)
    pq.write_table(evenly().slice(90), folder / "y.parquet")
    said = r"Time goes backwards at row 101.* 2 files .*from x\.parquet to y\.parquet: files that overlap"
    with pytest.raises(TimeError, match=said):
        becalm.read(folder)


@pytest.mark.parametrize(("size", "said"), [(0, "a damaged Parquet file"), (1000, "cut short")])
def test_a_damaged_file_is_named(size: int, said: str, tmp_path: Path) -> None:
    folder = cut(evenly(), [100], ["a.parquet", "b.parquet"], tmp_path)
    (folder / "b.parquet").write_bytes((folder / "b.parquet").read_bytes()[:size])
    with pytest.raises(InputError, match=rf"b\.parquet is {said}"):
        becalm.read(folder)


@pytest.mark.parametrize("names", [[], ["notes.txt"]])
def test_a_folder_without_parquet_is_a_directory(names: list[str], tmp_path: Path) -> None:
    for name in names:
        (tmp_path / name).write_text("words\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"is a directory; .*a folder with Parquet files"):
        becalm.read(tmp_path)


def test_a_file_that_changes_is_refused_and_one_that_comes_later_is_not_of_it(tmp_path: Path) -> None:
    folder = cut(evenly(), [100], ["a.parquet", "b.parquet"], tmp_path)
    with open_source(folder) as source:
        cut(evenly(), [], ["c.parquet"], folder)
        assert sum(len(chunk) for chunk in source.chunks(70)) == COUNT
        cut(evenly(), [100], ["new.parquet", "b.parquet"], folder)
        for use in (source.recording, source.sha256, lambda: list(source.chunks())):
            with pytest.raises(InputError, match=r"b\.parquet changed while it was read"):
                use()


def test_the_hash_is_that_of_names_and_files(tmp_path: Path) -> None:
    folder = cut(evenly(), [100], ["date=2/b.parquet", "a.parquet"], tmp_path)
    told = b"".join(
        f"{name}\0{hashlib.sha256((folder / name).read_bytes()).hexdigest()}\n".encode()
        for name in ("a.parquet", "date=2/b.parquet")
    )
    with open_source(folder) as source:
        assert source.sha256() == hashlib.sha256(told).hexdigest()


@pytest.mark.parametrize("start", [0, 49, 100, 101, 260, 299, 300])
def test_rows_start_anywhere_here_and_where_they_are_sent_to(start: int, tmp_path: Path) -> None:
    folder = cut(evenly(), [100, 101, 260], ["d.parquet", "c.parquet", "b.parquet", "a.parquet"], tmp_path)
    rows = pickle.loads(pickle.dumps(read_folder(folder).rows))
    blocks = list(rows.blocks(["walk", "time_s"], 30, start))
    assert all(0 < block.num_rows <= 30 for block in blocks)
    found = pa.concat_tables(blocks) if blocks else rows.schema.empty_table().select(["walk", "time_s"])
    assert found.to_pylist() == evenly().select(["walk", "time_s"]).slice(start).to_pylist()
