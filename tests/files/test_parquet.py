"""Parquet: every type of time and of number, by the same rules as CSV."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.errors import InputError
from becalm.files import ReadOptions, SourceFile, read_source

COUNT = 30
SIGNAL = np.random.default_rng(4).normal(size=COUNT)


def source_of(folder: Path, columns: dict[str, Any], **said: Any) -> SourceFile:
    path = folder / "log.parquet"
    pq.write_table(pa.table(columns), path)
    return read_source(path, ReadOptions(**said))


TICKS = {
    "timestamp ns": pa.array(np.arange(COUNT) * 10_000_000 + 1_646_670_915 * 10**9, pa.timestamp("ns")),
    "timestamp us, zone": pa.array(np.arange(COUNT) * 10_000, pa.timestamp("us", "Europe/Berlin")),
    "timestamp ms": pa.array(np.arange(COUNT) * 10, pa.timestamp("ms")),
    "duration": pa.array(np.arange(COUNT) * 10_000, pa.duration("us")),
    "time32": pa.array((np.arange(COUNT, dtype=np.int32) * 10 + 86_399_900) % 86_400_000, pa.time32("ms")),
    "time64": pa.array(np.arange(COUNT) * 10_000, pa.time64("us")),
    "float32": pa.array((np.arange(COUNT) / 100).astype(np.float32)),
    "epoch int": pa.array(np.arange(COUNT) * 10 + 1_646_670_915_000),
    "decimal": pa.array([Decimal(i) / 100 for i in range(COUNT)]),
    "text": pa.array([f"2022-03-07 10:00:00.{10 * i:03d}" for i in range(COUNT)]),
    "text in a dictionary": pa.array([f"2022-03-07 10:00:00.{10 * i:03d}" for i in range(COUNT)]).dictionary_encode(),
}


@pytest.mark.parametrize("ticks", TICKS.values(), ids=TICKS.keys())
def test_every_type_of_time(ticks: pa.Array, tmp_path: Path) -> None:
    source = source_of(tmp_path, {"time": ticks, "a": SIGNAL})
    np.testing.assert_allclose(source.recording.times_s, np.arange(COUNT) / 100, atol=1e-9)
    assert source.recording.timebase.uniform
    assert source.table["time"].combine_chunks().cast(pa.string()) == ticks.cast(pa.string())


def test_a_timestamp_is_time_whatever_its_name(tmp_path: Path) -> None:
    assert source_of(tmp_path, {"a": SIGNAL, "when": TICKS["timestamp ms"]}).layout.time_columns == ("when",)


def test_days_are_time(tmp_path: Path) -> None:
    source = source_of(tmp_path, {"date": pa.array(np.arange(COUNT, dtype=np.int32), pa.date32()), "a": SIGNAL})
    assert source.recording.rate_hz == pytest.approx(1 / 86_400)


NUMBERS = {
    "int8": pa.array([i % 7 for i in range(COUNT)], pa.int8()),
    "uint64": pa.array([i % 7 for i in range(COUNT)], pa.uint64()),
    "float16": pa.array(np.arange(COUNT).astype(np.float16) % 7),
    "float32": pa.array(np.arange(COUNT).astype(np.float32) % 7),
    "decimal": pa.array([Decimal(i % 7) for i in range(COUNT)]),
    "dictionary": pa.array([i % 7 for i in range(COUNT)]).dictionary_encode(),
}


@pytest.mark.parametrize("values", NUMBERS.values(), ids=NUMBERS.keys())
def test_every_type_of_number_is_a_channel(values: pa.Array, tmp_path: Path) -> None:
    source = source_of(tmp_path, {"time": TICKS["duration"], "a": values})
    assert source.recording.samples[:, 0].tolist() == [i % 7 for i in range(COUNT)]


def test_nulls_are_missing(tmp_path: Path) -> None:
    source = source_of(
        tmp_path, {"time": TICKS["duration"], "a": pa.array([None, 3, *range(COUNT - 2)]), "n": pa.nulls(COUNT)}
    )
    assert np.isnan(source.recording.channel("a")).sum() == 1
    assert np.isnan(source.recording.channel("n")).all()
    assert [column.missing for column in source.layout.columns] == [0, 1, COUNT]


def test_what_is_no_number_passes_through(tmp_path: Path) -> None:
    columns = {
        "time": TICKS["duration"],
        "a": SIGNAL,
        "on": pa.array([i % 3 == 0 for i in range(COUNT)]),
        "label": pa.array(["1.5"] * COUNT),
        "list": pa.array([[1.0]] * COUNT),
        "pair": pa.array([{"x": 1}] * COUNT),
        "raw": pa.array([b"\xff"] * COUNT),
    }
    source = source_of(tmp_path, columns)
    assert source.recording.names == ("a",)
    assert source.table.column_names == list(columns)
    assert source_of(tmp_path, columns, channels=("on", "label")).recording.samples[0].tolist() == [1.0, 1.5]
    with pytest.raises(InputError, match="list"):
        source_of(tmp_path, columns, channels=("list",))


def test_a_pandas_index_is_a_plain_column(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--rate HZ"):
        source_of(tmp_path, {"a": SIGNAL, "__index_level_0__": np.arange(COUNT)})
    counted = source_of(tmp_path, {"a": SIGNAL, "__index_level_0__": np.arange(COUNT)}, rate_hz=50.0)
    assert counted.recording.names == ("a",)


def test_units_come_from_the_field_or_the_name(tmp_path: Path) -> None:
    schema = pa.schema(
        [
            pa.field("time", pa.float64(), metadata={"unit": "ms"}),
            pa.field("a", pa.float64(), metadata={"unit": "µm/m"}),
        ]
    )
    table = pa.table([np.arange(COUNT) * 10.0, SIGNAL], schema=schema).append_column("b_mps2", pa.array(SIGNAL))
    pq.write_table(table, tmp_path / "u.parquet")
    source = read_source(tmp_path / "u.parquet")
    assert source.recording.units == ("um/m", "m/s^2")
    assert source.recording.rate_hz == pytest.approx(100)


def test_nested_columns_of_several_row_groups_pass_through(tmp_path: Path) -> None:
    words = pa.array([f"w{i % 7}" for i in range(COUNT)]).dictionary_encode()
    table = pa.table({"time": TICKS["duration"], "a": SIGNAL, "pair": pa.StructArray.from_arrays([words], ["k"])})
    pq.write_table(table, tmp_path / "log.parquet", row_group_size=10)
    with pytest.raises(pa.ArrowNotImplementedError):
        list(pq.ParquetFile(tmp_path / "log.parquet").iter_batches())
    assert read_source(tmp_path / "log.parquet").table["pair"].to_pylist() == table["pair"].to_pylist()


def test_a_column_that_cannot_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise pa.ArrowNotImplementedError("Nested data conversions not implemented")

    monkeypatch.setattr(pq.ParquetFile, "iter_batches", refuse)
    with pytest.raises(InputError, match=r"cannot be read, in 'pair' .*without that column") as refusal:
        source_of(tmp_path, {"time": TICKS["duration"], "a": SIGNAL, "pair": pa.array([{"x": 1}] * COUNT)})
    assert "damaged" not in str(refusal.value)


def test_no_rows_and_no_columns_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="It has columns but no rows"):
        source_of(tmp_path, {"time": pa.array([], pa.float64()), "a": pa.array([], pa.float64())})
    with pytest.raises(InputError, match="no columns"):
        source_of(tmp_path, {})


@pytest.mark.parametrize("asked", [("b", "a"), ("a", "c.d"), ("c.d", "b", "a"), ("c", "a")])
def test_channels_come_in_the_order_that_they_are_asked_for(asked: tuple[str, ...], tmp_path: Path) -> None:
    columns = {"time": TICKS["duration"], "a": SIGNAL, "b": SIGNAL + 10, "c.d": SIGNAL + 20}
    if "c" in asked:  # a column that pyarrow cannot tell by its name from those in it
        columns["c"] = SIGNAL + 30
    recording = source_of(tmp_path, columns, channels=asked).recording
    assert recording.names == asked
    np.testing.assert_array_equal(recording.samples, np.column_stack([columns[name] for name in asked]))
