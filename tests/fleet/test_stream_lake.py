"""Files of a lake as blocks of one sensor each: what can be read, and a sentence for what cannot."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.errors import InputError, UsageError
from becalm.fleet.stream import lake as stream_lake
from becalm.fleet.stream.blocks import SensorRows
from becalm.fleet.stream.columns import StreamSchema
from becalm.fleet.stream.lake import lake_shape, read_files
from becalm.fleet.stream.plan import SensorPlan
from streaming import BEGINS_S, Shelf

PLAN = SensorPlan(Shelf(), channels=("a", "b"))
COUNT = 6
STAMPS = np.arange(COUNT) * 20_000 + round(BEGINS_S * 1e6)  # microseconds
A, B = np.arange(COUNT) + 0.5, np.arange(COUNT) * 2.0


def written(place: Path, **columns: object) -> Path:
    place.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), place)
    return place


def read(shape: StreamSchema, *paths: Path) -> dict[str, list[SensorRows]]:
    """Return the blocks of each sensor."""
    batch = pa.RecordBatch.from_pydict({"path": [f"file:{path}" for path in paths]})
    found: dict[str, list[SensorRows]] = {}
    for told in read_files("/", shape, iter([batch])):
        for row in told.to_pylist():
            found.setdefault(row["sensor"], []).append(SensorRows.unpacked(row["batch"]))
    return found


def says(blocks: list[SensorRows]) -> list[str]:
    return [lost.says for block in blocks for lost in block.garbled]


@pytest.fixture
def lake(tmp_path: Path) -> Iterator[Path]:
    written(tmp_path / "sensor=1" / "a.parquet", time=pa.array(STAMPS, pa.timestamp("us")), a=A, b=B)
    return tmp_path  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("unit", "ticks"),
    [("us", STAMPS), ("ns", STAMPS * 1000), ("ms", STAMPS // 1000)],
)
def test_timestamps_of_any_unit_are_the_same_seconds(tmp_path: Path, unit: str, ticks: np.ndarray) -> None:
    place = written(tmp_path / "sensor=1" / "a.parquet", time=pa.array(ticks, pa.timestamp(unit, "UTC")), a=A, b=B)
    shape = lake_shape(str(tmp_path), PLAN)
    (block,) = read(shape, place)["1"]
    assert (shape.stamps, shape.channels) == ("timestamp", ("a", "b"))
    np.testing.assert_array_equal(block.time_s, STAMPS / 1e6)
    np.testing.assert_array_equal(block.values, np.column_stack([A, B]))


def test_nanoseconds_between_microseconds_are_kept(tmp_path: Path) -> None:
    place = written(tmp_path / "sensor=1" / "a.parquet", time=pa.array([1500, 2750], pa.timestamp("ns")), a=A[:2])
    (block,) = read(lake_shape(str(tmp_path), PLAN), place)["1"]
    assert np.isnan(block.values[:, 1]).all()
    np.testing.assert_allclose(block.time_s, [1.5e-6, 2.75e-6], rtol=1e-15)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("time", STAMPS / 1e6),
        ("time", STAMPS // 1000),
        ("time", STAMPS * 1000),
        ("time (ms)", STAMPS / 1e3),
        ("time", (STAMPS / 1e6).astype(np.int64)),
    ],
)
def test_numbers_are_seconds_or_what_they_look_like(tmp_path: Path, name: str, numbers: np.ndarray) -> None:
    place = written(tmp_path / "sensor=1" / "a.parquet", **{name: numbers, "a": A})
    shape = lake_shape(str(tmp_path), SensorPlan(Shelf(), time=name, channels=("a",)))
    (block,) = read(shape, place)["1"]
    assert shape.stamps == "double"
    digit_s = 1.0 if name == "time" and numbers.dtype == np.int64 and numbers[0] < 1e11 else 1e-3
    assert np.all(np.abs(block.time_s - STAMPS / 1e6) < digit_s)


def test_a_key_is_a_folder_or_a_column(tmp_path: Path) -> None:
    time = pa.array(STAMPS, pa.timestamp("us"))
    one = written(tmp_path / "sensor=k%C3%A4se 1" / "date=2026-01-02" / "a.parquet", time=time, a=A)
    two = written(tmp_path / "b.parquet", time=time, a=A, sensor=pa.array(["x", "y", None] * 2).dictionary_encode())
    found = read(StreamSchema("sensor", "time", ("a",), "timestamp"), one, two)
    assert sorted(found) == ["", "käse 1", "x", "y"]
    np.testing.assert_array_equal(found["y"][0].values[:, 0], A[1::3])


def test_rows_of_nobody_have_no_name(tmp_path: Path) -> None:
    place = written(tmp_path / "sensor=__HIVE_DEFAULT_PARTITION__" / "a.parquet", time=STAMPS / 1e6, a=A)
    assert sorted(read(StreamSchema("sensor", "time", ("a",)), place)) == [""]


def test_files_of_odd_kinds_stop_nobody(tmp_path: Path) -> None:
    times, fine = STAMPS / 1e6, tmp_path / "sensor=1" / "fine.parquet"
    lists = pa.ListArray.from_arrays(np.arange(COUNT + 1), pa.array(STAMPS, pa.timestamp("us")))
    shape = StreamSchema("sensor", "time", ("a",))
    found = read(
        shape,
        written(tmp_path / "no key.parquet", time=times, a=A),
        written(tmp_path / "key.parquet", time=times, a=A, sensor=[["x"]] * COUNT),
        written(tmp_path / "sensor=2" / "a.parquet", time=lists, a=A),
        written(fine, time=times, a=A),
    )
    assert len(found["1"][0].time_s) == COUNT
    assert "has neither a column 'sensor' nor a folder like sensor=17" in " ".join(says(found[""]))
    assert "has array<timestamp> in its column 'time', but other files have numbers" in says(found["2"])[0]


def test_a_shape_is_that_of_the_first_file_that_has_one(tmp_path: Path) -> None:
    written(tmp_path / "sensor=1" / "other.parquet", when=STAMPS / 1e6, z=A)
    written(tmp_path / "sensor=2" / "one.parquet", time=STAMPS / 1e6, a=A)
    assert lake_shape(str(tmp_path), PLAN).channels == ("a", "b")


def test_units_come_along_and_part_blocks(tmp_path: Path) -> None:
    paths = []
    for number, unit in enumerate(["m", "mm", "m"]):
        fields = [pa.field("time", pa.float64()), pa.field("a", pa.float64(), metadata={"unit": unit})]
        path = tmp_path / "sensor=1" / f"{number}.parquet"
        path.parent.mkdir(exist_ok=True)
        pq.write_table(pa.table([STAMPS / 1e6, A], schema=pa.schema(fields)), path)
        paths.append(path)
    blocks = read(lake_shape(str(tmp_path), PLAN), *paths)["1"]
    assert [(block.units, len(block.time_s)) for block in blocks] == [(("m", ""), 2 * COUNT), (("mm", ""), COUNT)]


def test_a_channel_that_a_file_has_not_is_missing(lake: Path) -> None:
    place = written(lake / "sensor=2" / "a.parquet", time=STAMPS / 1e6, b=B.astype(np.int32))
    (block,) = read(lake_shape(str(lake), PLAN), place)["2"]
    np.testing.assert_array_equal(block.values, np.column_stack([np.full(COUNT, np.nan), B]))


def test_files_that_cannot_be_read_stop_nobody_and_say_why(lake: Path) -> None:
    shape = lake_shape(str(lake), PLAN)
    rubbish = lake / "sensor=2" / "a.parquet"
    rubbish.parent.mkdir()
    rubbish.write_bytes(b"rubbish")
    text = written(lake / "sensor=3" / "a.parquet", time=STAMPS / 1e6, a=["x"] * COUNT)
    other = written(lake / "sensor=4" / "a.parquet", when=STAMPS / 1e6, a=A)
    lists = written(lake / "sensor=5" / "a.parquet", time=[[1.0]] * COUNT, a=[[1.0]] * COUNT)
    gone = lake / "sensor=6" / "gone.parquet"
    found = read(shape, rubbish, text, other, lists, gone, lake / "sensor=1" / "a.parquet")
    assert len(found["1"][0].time_s) == COUNT
    assert all(len(block.time_s) == 0 for sensor in "23456" for block in found[sensor])
    assert "is not a Parquet file" in says(found["2"])[0]
    assert "has string in its column 'a', but other files have numbers" in says(found["3"])[0]
    assert "needs 'time' and one of 'a', 'b', but has 'when', 'a'" in says(found["4"])[0]
    assert "has array<double> in its column 'time', but other files have numbers" in says(found["5"])[0]
    assert all("add it under another name" in says(found[sensor])[0] for sensor in "23456")


def test_a_lake_s_shape_is_that_of_a_file_that_can_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no Parquet file yet"):
        lake_shape(str(tmp_path), PLAN)
    written(tmp_path / "_temporary" / "a.parquet", time=[1], z=[1])
    (tmp_path / "bad.parquet").write_bytes(b"rubbish")
    with pytest.raises(InputError, match=r"bad\.parquet is not a Parquet file"):
        lake_shape(str(tmp_path), PLAN)
    written(tmp_path / "sensor=1" / "b.parquet", time=[[1.0, 2.0]], b=[[3.0, 4.0]])
    shape = lake_shape(str(tmp_path), PLAN)
    assert (shape.channels, shape.in_blocks) == (("a", "b"), True)


def test_a_lake_without_a_key_is_refused(tmp_path: Path) -> None:
    written(tmp_path / "a.parquet", time=[1.0], a=[1.0])
    with pytest.raises(UsageError, match="no column 'sensor'"):
        lake_shape(str(tmp_path), PLAN)
    (tmp_path / "a.parquet").unlink()
    written(tmp_path / "sensor=1" / "a.parquet", time=[[1.0]], a=[1.0])
    with pytest.raises(UsageError, match="'a' has double; readings are arrays of numbers"):
        lake_shape(str(tmp_path), PLAN)


@pytest.mark.parametrize(
    ("cause", "passes"),
    [
        (OSError(errno.ESTALE, "Stale file handle"), True),
        (OSError(errno.EMFILE, "Too many open files"), True),
        (MemoryError("no memory"), True),
        (pa.ArrowMemoryError("malloc of size 9e18 failed"), False),
        (FileNotFoundError(errno.ENOENT, "No such file"), False),
        (OSError("Couldn't deserialize thrift"), False),
        (ValueError("rubbish"), False),
    ],
)
def test_a_file_that_the_machine_could_not_read_is_left_for_another_try(
    lake: Path, monkeypatch: pytest.MonkeyPatch, cause: Exception, passes: bool
) -> None:
    shape = lake_shape(str(lake), PLAN)

    def opened(path: Path, kept: object) -> None:
        if isinstance(cause, OSError):
            raise InputError(f"{path} is damaged.") from cause
        raise cause

    monkeypatch.setattr(stream_lake, "ParquetRows", opened)
    if passes:
        with pytest.raises(InputError, match="cannot be read now"):
            read(shape, lake / "sensor=1" / "a.parquet")
    else:
        assert says(read(shape, lake / "sensor=1" / "a.parquet")["1"])


def test_folders_above_the_lake_tell_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = written(
        tmp_path / "sensor=above" / "lake" / "a.parquet", sensor=list("ststst"), time=STAMPS / 1e6, a=A, b=B
    )
    lake = tmp_path / "sensor=above" / "lake"
    monkeypatch.chdir(lake.parent)
    for said in (lake, Path("lake")):
        batch = pa.RecordBatch.from_pydict({"path": [f"file:{place}"]})
        told = pa.Table.from_batches(read_files(str(said), lake_shape(str(said), PLAN), iter([batch])))
        assert sorted(told["sensor"].to_pylist()) == ["s", "t"]


def test_an_odd_first_stamp_does_not_tell_what_numbers_count(tmp_path: Path) -> None:
    ticks = STAMPS // 1000
    ticks[0] = 0
    place = written(tmp_path / "sensor=1" / "a.parquet", time=ticks, a=A, b=B)
    (block,) = read(lake_shape(str(tmp_path), PLAN), place)["1"]
    np.testing.assert_array_equal(block.time_s[1:], STAMPS[1:] // 1000 / 1e3)


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere is not a folder"):
        lake_shape(str(tmp_path / "nowhere"), PLAN)


@pytest.mark.parametrize(
    ("uri", "path"),
    [("file:/lake/a b", "/lake/a b"), ("file:///lake/a%20b", "/lake/a%20b"), ("file:///C:/lake/a", "C:/lake/a")],
)
def test_a_path_is_as_spark_names_it(uri: str, path: str) -> None:
    assert stream_lake._path_of(uri) == Path(path)
