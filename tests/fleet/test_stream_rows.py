"""Rows and blocks of rows on their way to the filters and back."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

import becalm.fleet.stream
from becalm.errors import ModelError, UsageError
from becalm.fleet.stream import gathering
from becalm.fleet.stream.blocks import EstimatedBlock, SensorRows
from becalm.fleet.stream.columns import StreamSchema, shape_of
from becalm.fleet.stream.gathering import gathered
from becalm.fleet.stream.output_batches import to_output_batches
from becalm.fleet.stream.state import SensorState
from becalm.live.block import Block, Checkpoint

SCHEMA = pa.schema(
    [("sensor", pa.string()), ("time", pa.timestamp("us", "UTC")), ("a", pa.float64()), ("b", pa.float64())]
)


def of_sensors(batches: Iterator[pa.RecordBatch]) -> dict[str, SensorRows]:
    """Return all rows of each sensor, as they came."""
    found: dict[str, list[SensorRows]] = {}
    for batch in batches:
        for row in batch.to_pylist():
            found.setdefault(row["sensor"], []).append(SensorRows.unpacked(row["batch"]))
    return {
        sensor: SensorRows(
            np.concatenate([one.time_s for one in parts]),
            np.concatenate([one.values for one in parts]),
            (),
            tuple(lost for one in parts for lost in one.garbled),
        )
        for sensor, parts in found.items()
    }


@given(
    rows=st.lists(st.tuples(st.sampled_from(["s1", "s2", "käse", None]), st.none() | st.floats(-9, 9)), max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=4),
)
def test_each_sensor_keeps_its_rows_in_their_order(
    rows: list[tuple[str | None, float | None]], cuts: list[int]
) -> None:
    stamps = [1_764_000_000_000_000 + 10_001 * k for k in range(len(rows))]
    table = pa.table([[s for s, _ in rows], stamps, [v for _, v in rows], [None] * len(rows)], schema=SCHEMA)
    edges = sorted({0, len(rows), *(min(cut, len(rows)) for cut in cuts)})
    batches = [table.slice(a, b - a).combine_chunks().to_batches() for a, b in pairwise(edges)]
    found = of_sensors(gathered(2, (batch for some in batches for batch in some)))
    assert set(found) == {sensor or "" for sensor, _ in rows}
    for sensor, got in found.items():
        own = [k for k, (name, _) in enumerate(rows) if (name or "") == sensor]
        np.testing.assert_array_equal(got.time_s, [stamps[k] / 1e6 for k in own])
        readings = [rows[k][1] for k in own]
        np.testing.assert_array_equal(got.values[:, 0], np.array(readings, np.float64))
        assert np.isnan(got.values[:, 1]).all()


def test_rows_go_on_before_all_have_come(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gathering, "_HELD_ROWS", 10)
    table = pa.table([["s"] * 25, list(range(25)), np.arange(25.0), np.arange(25.0)], schema=SCHEMA)
    batches = list(gathered(2, iter(table.to_batches(max_chunksize=5))))
    assert [len(SensorRows.unpacked(batch["batch"][0].as_py()).time_s) for batch in batches] == [10, 10, 5]


def in_lists(sensors: list[str], *columns: Any) -> pa.RecordBatch:
    lists = [pa.array(column, pa.list_(pa.float64())) for column in columns]
    return pa.RecordBatch.from_arrays([pa.array(sensors), *lists], names=["sensor", "time", "a", "b"])


def test_blocks_are_laid_out() -> None:
    batch = in_lists(
        ["s", "t", "s"],
        [[1.0, 2.0], [3.0], [4.0, None, 6.0]],
        [[10.0, None], [30.0], [40.0, 50.0, 60.0]],
        [None, [31.0], [41.0, 51.0, 61.0]],
    )
    found = of_sensors(gathered(2, iter([batch])))
    np.testing.assert_array_equal(found["s"].time_s, [1, 2, 4, np.nan, 6])
    np.testing.assert_array_equal(found["s"].values[:, 0], [10, np.nan, 40, 50, 60])
    np.testing.assert_array_equal(found["s"].values[:, 1], [np.nan, np.nan, 41, 51, 61])
    np.testing.assert_array_equal(found["t"].values, [[30, 31]])


def test_blocks_whose_columns_differ_in_length_are_none() -> None:
    batch = in_lists(
        ["s", "s", "t", "u"],
        [[1.0, 2.0], [3.0], [4.0], None],
        [[10.0, 20.0], [30.0, 31.0], [], [1.0]],
        [[11.0, 21.0], [32.0], [40.0], None],
    )
    found = of_sensors(gathered(2, iter([batch])))
    np.testing.assert_array_equal(found["s"].values, [[10, 11], [20, 21]])
    assert [[lost.things for lost in found[sensor].garbled] for sensor in "stu"] == [[1], [1], [1]]
    assert len(found["t"].time_s) == len(found["u"].time_s) == 0


def test_a_slice_of_lists_is_its_own() -> None:
    whole = in_lists(["s"] * 4, *([[float(k + c)] * k for k in range(4)] for c in (0, 10, 20)))
    found = of_sensors(gathered(2, iter([whole.slice(2)])))
    np.testing.assert_array_equal(found["s"].values[:, 0], [12, 12, 13, 13, 13])


def answers_of(*rows: dict[str, Any]) -> pa.RecordBatch:
    """Return what filters answered."""
    fields = {"sensor": pa.string(), "estimates": pa.binary(), "recipe": pa.string(), "event": pa.string()}
    fields |= {"event_rows": pa.int64(), "says": pa.string(), "noticed_ms": pa.int64()}
    shared = {"sensor": "s", "recipe": "abc", "noticed_ms": 1_764_000_000_123}
    return pa.RecordBatch.from_pylist([shared | row for row in rows], schema=pa.schema(list(fields.items())))


def told_of(rows: int) -> EstimatedBlock:
    verdicts = np.arange(2 * rows, dtype=np.int8).reshape(rows, 2) % 13
    numbers = np.random.default_rng(2).normal(size=(2, rows, 2))
    return EstimatedBlock(
        np.array([1, 0]), 1.764e9 + np.round(np.arange(rows) * 8000.0) / 1e6, numbers[0], numbers[1], verdicts
    )


@pytest.mark.parametrize("stamps", ["double", "timestamp", "timestamp_ntz"])
@pytest.mark.parametrize("in_blocks", [False, True])
def test_what_is_told_has_the_shape_that_came(stamps: Any, in_blocks: bool) -> None:
    shape, told = StreamSchema("sensor", "time", ("a", "b"), stamps, in_blocks), told_of(50)
    batch = answers_of({"estimates": told.packed()}, {"event": "late", "event_rows": 3, "says": "Late."})
    events, readings = to_output_batches(shape, iter([batch]))
    assert [name for name, _ in shape.output_columns] == events.schema.names == readings.schema.names
    (event,) = events.to_pylist()
    assert (event["kind"], event["event"], event["event_rows"], event["says"]) == ("events", "late", 3, "Late.")
    assert event["noticed"].timestamp() == 1_764_000_000.123
    assert event["a"] is event["time"] is None
    assert readings.num_rows == (1 if in_blocks else 50)
    flat = {name: readings[name].flatten() if in_blocks else readings[name] for name in ("time", "a", "b", "b_sigma")}
    np.testing.assert_array_equal(flat["a"], told.signal[:, 1])
    np.testing.assert_array_equal(flat["b_sigma"], told.sigma[:, 0])
    time = flat["time"]
    seconds = time.to_numpy() if stamps == "double" else time.cast(pa.int64()).to_numpy() / 1e6
    np.testing.assert_array_equal(seconds, told.time_s)
    words = readings["b_verdict"].flatten() if in_blocks else readings["b_verdict"]
    assert words[:3].to_pylist() == ["used", "nonfinite", "spike"]
    assert set(readings["recipe"].to_pylist()) == {"abc"}


def test_a_channel_that_a_sensor_has_not_is_null() -> None:
    shape = StreamSchema("sensor", "time", ("a", "b", "c"))
    (readings,) = to_output_batches(shape, iter([answers_of({"estimates": told_of(5).packed()})]))
    assert readings["c"].null_count == readings["c_verdict"].null_count == 5


@given(st.integers(0, 4_000_000_000_000_000))
def test_timestamps_come_back_as_they_were(micros: int) -> None:
    told = told_of(1)._replace(time_s=np.array([micros / 1e6]))
    shape = StreamSchema("sensor", "time", ("a", "b"), "timestamp")
    (readings,) = to_output_batches(shape, iter([answers_of({"estimates": told.packed()})]))
    assert readings["time"].cast(pa.int64()).to_pylist() == [micros]


COLUMNS = [("sensor", "string"), ("time", "timestamp"), ("a", "double"), ("b", "int"), ("note", "string")]


def test_rows_need_not_have_all_channels() -> None:
    assert shape_of(COLUMNS, "sensor", "time", ("b", "z")).channels == ("b", "z")
    in_blocks = [("sensor", "string"), ("time", "array<double>"), ("a", "array<float>"), ("b", "double")]
    shape = shape_of(in_blocks, "sensor", "time", ("a",))
    assert (shape.channels, shape.stamps, shape.in_blocks) == (("a",), "double", True)


@pytest.mark.parametrize(
    ("key", "time", "channels", "says"),
    [
        ("pump", "time", ("a",), "no column 'pump'; they have 'sensor', 'time'"),
        ("sensor", "t", ("a",), "no column 't'"),
        ("sensor", "time", ("c",), "no column 'c'"),
        ("sensor", "time", ("note",), "'note' has string; readings are numbers"),
        ("sensor", "note", ("a",), "'note' has string; stamps must be timestamps"),
        ("sensor", "b", ("a",), "'b' has int; stamps must be"),
    ],
)
def test_columns_that_cannot_be_are_refused(key: str, time: str, channels: tuple[str, ...], says: str) -> None:
    with pytest.raises(UsageError, match=says):
        shape_of(COLUMNS, key, time, channels)


def test_whole_numbers_as_stamps_are_told_how_to_become_some() -> None:
    with pytest.raises(UsageError, match=r"col\('time'\) / 1e9"):
        shape_of([("sensor", "string"), ("time", "bigint"), ("a", "double")], "sensor", "time", ("a",))


def test_names_that_would_stand_twice_are_refused() -> None:
    with pytest.raises(UsageError, match="'a_sigma'"):
        StreamSchema("sensor", "time", ("a", "a_sigma"))
    with pytest.raises(UsageError, match="'kind'"):
        StreamSchema("kind", "time", ("a",))


def test_names_are_quoted() -> None:
    assert StreamSchema("sensor", "time", ("load `N`",)).output_ddl.count("`load ``N```") == 1


def test_a_state_is_read_as_it_was_written() -> None:
    held = Block(("a", "b"), ("m", ""), np.arange(3.0), np.arange(6.0).reshape(3, 2))
    state = SensorState(5, True, False, "x", "y", Checkpoint(7, "", b"abc", "recipe", ""), held, {"next": 4})
    again = SensorState.unpacked(state.packed())
    assert again.packed() == state.packed()
    assert (again.stream, again.is_silent, again.messages) == (state.stream, True, {"next": 4})
    np.testing.assert_array_equal(again.held.values, held.values)
    assert SensorState.unpacked(SensorState(1).packed()).stream is None


def test_a_state_that_is_none_is_refused() -> None:
    for blob in (b"", b"abc", SensorState(1).packed()[:-1]):
        with pytest.raises(ModelError, match="damaged"):
            SensorState.unpacked(blob)


def test_spark_is_loaded_only_when_it_is_asked_for() -> None:
    code = "import sys, becalm.fleet.stream as s; assert s.LiveBook and 'pyspark' not in sys.modules; assert s.run"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_what_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'walk'"):
        _ = becalm.fleet.stream.walk
