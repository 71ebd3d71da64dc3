"""Rows of shared files brought together: named by their sensors, parted, and merged in the order of time."""

from __future__ import annotations

import tempfile
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from becalm.errors import InputError, UsageError
from becalm.fleet.grouped import strips
from becalm.fleet.grouped.counting import count_rows
from becalm.fleet.grouped.merging import merge_strips
from becalm.fleet.grouped.strips import Lake, Strip, StripPart, split_rows
from becalm.fleet.marks import hash_input
from becalm.fleet.names import NULL, below, folder_name, keys_of, name_sensors, values_in
from shared_lakes import KEY, keyed

WORDS = st.text(max_size=12)


def brought_together(folder: Path, files: int, sensor: str, parts: int = 1, time: str | None = None) -> pa.Table:
    """Part some files of a lake, and merge one sensor."""
    found: list[Strip] = []
    for number in range(files * parts):
        target = str(folder / f"{number}.strips")
        lake = Lake(str(folder), (KEY,), {sensor: time})
        file = f"{number // parts}.parquet"
        hashed = hash_input([(file, folder / file)], "", {})
        told = split_rows(lake, StripPart(file, number % parts, parts, target, hashed))
        assert not told.failed
        found += told.by_sensor.get(sensor, [])
    return pa.concat_tables(list(merge_strips(folder, found)))


@given(WORDS | st.none(), WORDS | st.none())
def test_every_value_has_a_folder_of_its_own(one: str | None, other: str | None) -> None:
    name = folder_name("sensor", one)
    assert values_in(PurePath(name)) == {"sensor": one}
    assert PurePath(name).parts == (name,)
    assert (name == folder_name("sensor", other)) == (one == other)


@pytest.mark.parametrize(
    ("value", "name"),
    [
        ("17", "k=17"),
        ("a/b c:d%", "k=a%2Fb c%3Ad%25"),
        ("Motor Süd ü", "k=Motor Süd ü"),
        ("..", "k=.."),
        ("", "k="),
        (None, f"k={NULL}"),
        ("new\nline", "k=new%0Aline"),
    ],
)
def test_folders_are_called_as_hive_calls_them(value: str | None, name: str) -> None:
    assert folder_name("k", value) == name


@pytest.mark.parametrize(
    ("column", "names"),
    [
        (pa.array(["007", "7", None, "007"]), ["k=007", "k=7", f"k={NULL}"]),
        (pa.array(["a", "b", "a"]).dictionary_encode(), ["k=a", "k=b"]),
        (pa.array([7, None, 7], pa.uint64()), ["k=7", f"k={NULL}"]),
        (pa.array([17.0, np.nan]), ["k=17", "k=nan"]),  # whole numbers with nulls, as pandas holds them
        (pa.array([b"x", b"y"]), ["k=x", "k=y"]),
        (pa.array([True, False]), ["k=true", "k=false"]),
        (pa.nulls(2), [f"k={NULL}"]),
    ],
)
def test_any_plain_column_names_sensors(column: pa.Array, names: list[str]) -> None:
    own = name_sensors(pa.table({"k": column}), ("k",), {})
    assert sorted(own.names) == sorted(names)
    told = [folder_name("k", value) for value in pa.chunked_array([column]).cast(pa.string()).to_pylist()]
    assert [own.names[code] for code in own.codes] == told


def test_several_columns_and_folders_name_sensors_together() -> None:
    block = pa.table({"plant": [1, 1, 2, 2], "sensor": ["a", "b", "a", "a"]})
    own = name_sensors(block, ("plant", "line", "sensor"), {"line": "x"})
    told = [f"plant={plant}/line=x/sensor={sensor}" for plant, sensor in ((1, "a"), (1, "b"), (2, "a"), (2, "a"))]
    assert [own.names[code] for code in own.codes] == told
    assert len(own.names) == 3


def test_lists_name_no_sensor() -> None:
    with pytest.raises(InputError, match="cannot name a folder"):
        name_sensors(pa.table({"k": [[1], [2]]}), ("k",), {})


def test_a_key_that_is_not_there_is_said_with_those_that_are() -> None:
    with pytest.raises(UsageError, match=r"--by names 'pump', which .* there are sensor, time_s\."):
        keys_of("pump", ["time_s", "sensor"])
    assert keys_of("a,b", ["a,b", "a", "b"]) == ("a,b",)
    assert keys_of("a, b", ["a", "b"]) == ("a", "b")


def test_an_output_lies_below_its_sensor_without_naming_it_twice() -> None:
    assert below("sensor=a%2Fb", PurePath("date=1/sensor=a%2Fb/x.parquet")) == "date=1/x.parquet"
    assert below("plant=1/sensor=2", PurePath("plant=1/date=3/sensor=2/hour=2/x.parquet")) == "date=3/hour=2/x.parquet"


@given(data=st.data())
def test_rows_come_in_the_order_of_time_and_equal_ones_as_they_were(data: st.DataObject) -> None:
    count, files = data.draw(st.integers(1, 60)), data.draw(st.integers(1, 3))
    stamps = st.one_of(st.integers(0, 9), st.just(np.nan))
    times = np.array(data.draw(st.lists(stamps, min_size=count, max_size=count)), float)
    sensors = np.array(data.draw(st.lists(st.sampled_from("xyz"), min_size=count, max_size=count)))
    table = pa.table({KEY: sensors, "time_s": times, "row": np.arange(count)})
    ends = sorted(data.draw(st.lists(st.integers(0, count), min_size=files - 1, max_size=files - 1)))
    rows = np.flatnonzero(sensors == "x")
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as name:
        patch.setattr(strips, "BATCH_ROWS", data.draw(st.integers(1, 7)))
        for number, (first, stop) in enumerate(zip([0, *ends], [*ends, count], strict=True)):
            pq.write_table(table.slice(first, stop - first), Path(name) / f"{number}.parquet", row_group_size=5)
        if len(rows):
            got = brought_together(Path(name), files, "sensor=x", data.draw(st.integers(1, 4)))
            assert got.column_names == ["time_s", "row"]
            assert got.column("row").to_pylist() == rows[np.argsort(times[rows], kind="stable")].tolist()


EVERYTHING: dict[str, pa.Array] = {
    "naive": pa.array([3, 1, 2], pa.timestamp("us")),
    "utc": pa.array([3, None, 2], pa.timestamp("ns", "UTC")),
    "zoned": pa.array([3, 1, 2], pa.timestamp("ms", "Europe/Berlin")),
    "day": pa.array([3, 1, 2], pa.date32()),
    "of_day": pa.array([3, 1, 2], pa.time64("ns")),
    "lasted": pa.array([3, 1, 2], pa.duration("ns")),
    "large": pa.array([2**64 - 1, None, 0], pa.uint64()),
    "small": pa.array([3, 1, 2], pa.int8()),
    "half": pa.array(np.array([3, 1, np.nan], np.float16)),
    "exact": pa.array([3, 1, 2]).cast(pa.decimal128(30, 9)),
    "words": pa.array(["c", None, ""]),
    "kinds": pa.array(["c", "a", "c"]).dictionary_encode(),
    "bytes": pa.array([b"\xff", None, b""]),
    "lists": pa.array([[3], [], None]),
    "structs": pa.array([{"x": 3}, {"x": None}, None]),
    "flags": pa.array([True, None, False]),
    "nothing": pa.nulls(3),
}


def test_values_types_and_units_are_those_of_the_file(tmp_path: Path) -> None:
    names = ["time_s", *EVERYTHING]
    fields = [pa.field(name, own.type, metadata={b"unit": b"m"}) for name, own in EVERYTHING.items()]
    schema = pa.schema([pa.field("time_s", pa.int64()), *fields], {b"made by": b"a logger"})
    table = pa.table([pa.array([3, 1, 2]), *EVERYTHING.values()], schema=schema)
    pq.write_table(keyed(table, "x").replace_schema_metadata(schema.metadata), tmp_path / "0.parquet")
    stored = pq.read_table(tmp_path / "0.parquet").select(names)
    got = brought_together(tmp_path, 1, "sensor=x")
    expected = stored.take([1, 2, 0])
    for name in names:
        assert repr(got.column(name).to_pylist()) == repr(expected.column(name).to_pylist()), name
    assert [field.metadata for field in got.schema] == [field.metadata for field in stored.schema]
    plain = [field.type.value_type if field.name == "kinds" else field.type for field in stored.schema]
    assert got.schema.types == plain
    assert got.schema.metadata[b"made by"] == b"a logger"


@pytest.mark.parametrize(
    "times",
    [
        pa.array([5, 1, 3, 2], pa.timestamp("ns")),
        pa.array([5, 1, 3, 2], pa.date32()),
        pa.array([5, 1, 3, 2], pa.duration("us")),
        pa.array([2**63 + 5, 2**63 + 1, 2**63 + 3, 2**63 + 2], pa.uint64()),  # apart by less than float64 tells
        pa.array([17 * 10**17 + 5, 17 * 10**17 + 1, 17 * 10**17 + 3, 17 * 10**17 + 2]),
        pa.array([0.5, 0.1, 0.3, 0.2], pa.float32()),
        pa.array(["2026-01-02 10:00:05", "2026-01-02 10:00:01", "2026-01-02T10:00:03.5", "2026-01-02 10:00:02.25"]),
        pa.array(["2026-01-05", "2026-01-01", "2026-01-03", "2026-01-02"]),
    ],
    ids=lambda times: str(times.type),
)
def test_time_may_be_anything_that_tells_it(tmp_path: Path, times: pa.Array) -> None:
    pq.write_table(keyed(pa.table({"timestamp": times, "row": range(4)}), "x"), tmp_path / "0.parquet")
    assert brought_together(tmp_path, 1, "sensor=x").column("row").to_pylist() == [1, 3, 2, 0]


def test_date_and_time_of_day_apart_order_rows_together(tmp_path: Path) -> None:
    columns: dict[str, Any] = {
        "date": ["2026-01-02", "2026-01-01", "2026-01-02"],
        "time": ["10:00:00", "11:00:00", "09:00:00"],
        "row": range(3),
    }
    pq.write_table(keyed(pa.table(columns), "x"), tmp_path / "0.parquet")
    assert brought_together(tmp_path, 1, "sensor=x").column("row").to_pylist() == [1, 2, 0]


def test_the_recipe_says_which_column_is_the_time(tmp_path: Path) -> None:
    pq.write_table(keyed(pa.table({"time_s": [1, 2, 3], "t2": [2, 3, 1]}), "x"), tmp_path / "0.parquet")
    assert brought_together(tmp_path, 1, "sensor=x").column("t2").to_pylist() == [2, 3, 1]
    assert brought_together(tmp_path, 1, "sensor=x", time="t2").column("t2").to_pylist() == [1, 2, 3]


@pytest.mark.parametrize(
    "times",
    [
        pa.array(np.arange(1000) * 100 % 2**16),  # a counter of 16 bits
        pa.array((np.arange(1000) * 10 % 3600).astype("datetime64[s]") + np.timedelta64(0, "s")),  # hours put back
        pa.array([f"{12 + k // 600}:00" for k in range(1000)]),  # of no day that is told
        pa.array([None] * 1000, pa.float64()),
    ],
    ids=["wraps", "hours", "of day", "unknown"],
)
def test_a_clock_that_is_mended_later_or_tells_nothing_leaves_rows_as_they_are(tmp_path: Path, times: pa.Array) -> None:
    pq.write_table(keyed(pa.table({"time": times, "row": range(1000)}), "x"), tmp_path / "0.parquet")
    assert brought_together(tmp_path, 1, "sensor=x").column("row").to_pylist() == [*range(1000)]


def test_numbers_that_only_happen_to_rise_are_no_time(tmp_path: Path) -> None:
    readings = [*range(300), *range(300)]
    pq.write_table(pa.table({"a": readings, "b": range(600), KEY: ["x"] * 600}), tmp_path / "0.parquet")
    assert brought_together(tmp_path, 1, "sensor=x").column("b").to_pylist() == [*range(600)]


def test_files_that_differ_are_refused_by_their_own_names(tmp_path: Path) -> None:
    pq.write_table(keyed(pa.table({"time_s": [1.0], "a": [1.0]}), "x"), tmp_path / "0.parquet")
    pq.write_table(keyed(pa.table({"time_s": [2.0], "b": [1.0]}), "x"), tmp_path / "1.parquet")
    with pytest.raises(InputError, match=r"1\.parquet lacks the column 'a' that .*/0\.parquet has"):
        brought_together(tmp_path, 2, "sensor=x")


def test_files_may_have_their_columns_in_any_order(tmp_path: Path) -> None:
    pq.write_table(keyed(pa.table({"time_s": [2.0], "a": [1.0]}), "x"), tmp_path / "0.parquet")
    pq.write_table(keyed(pa.table({"a": [3.0], "time_s": [1.0]}), "x"), tmp_path / "1.parquet")
    assert brought_together(tmp_path, 2, "sensor=x").to_pydict() == {"time_s": [1.0, 2.0], "a": [3.0, 1.0]}


def test_a_file_is_counted_by_its_keys_alone(tmp_path: Path) -> None:
    table = pa.concat_tables([keyed(pa.table({"a": range(n)}), name) for name, n in (("x", 3), ("y/z", 2), ("x", 1))])
    pq.write_table(table, tmp_path / "0.parquet")
    count = count_rows(str(tmp_path), (KEY,), "0.parquet")
    assert count.rows == {"sensor=x": 4, "sensor=y%2Fz": 2}
    assert count.hashed == count_rows(str(tmp_path), (KEY,), "0.parquet").hashed
    pq.write_table(table.slice(1), tmp_path / "0.parquet")
    assert count.hashed != count_rows(str(tmp_path), (KEY,), "0.parquet").hashed


def test_a_file_without_the_key_is_named_with_what_it_has(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time_s": [1.0], "a": [1.0]}), tmp_path / "0.parquet")
    failed = count_rows(str(tmp_path), (KEY,), "0.parquet").failed
    assert "0.parquet has no column 'sensor'" in failed
    assert "time_s, a" in failed


@pytest.mark.parametrize("time", ["time_s", None])
def test_of_many_strips_few_are_in_memory(tmp_path: Path, time: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sensors that share files have small strips, each of which is a whole batch."""
    rows, of_a_block = 400_000, 2000
    monkeypatch.setattr(strips, "_share_of", lambda path, table, part: table.blocks(table.names, most_rows=of_a_block))
    own = pa.table({KEY: ["x"] * rows, "time_s": np.arange(rows) / 100, "a": np.arange(rows) / 7})
    pq.write_table(own, tmp_path / "0.parquet")
    hashed = hash_input([("0.parquet", tmp_path / "0.parquet")], "", {})
    found = split_rows(
        Lake(str(tmp_path), (KEY,), {"sensor=x": time}), StripPart("0.parquet", 0, 1, str(tmp_path / "s"), hashed)
    ).by_sensor["sensor=x"]
    assert len(found) == rows // of_a_block
    before, most, count = pa.total_allocated_bytes(), 0, 0
    for table in merge_strips(tmp_path, found):
        most, count = max(most, pa.total_allocated_bytes() - before), count + table.num_rows
    assert count == rows
    assert most < 8 * of_a_block * 24  # of the 200 strips that there are
