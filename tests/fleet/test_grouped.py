"""Lakes whose sensors a column tells apart: the numbers of each sensor's own file, and no sensor stops the others."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.errors import InputError, UsageError
from becalm.fleet.batch import BatchOptions, clean
from becalm.fleet.grouped import cleaning
from becalm.fleet.grouped.strips import split_rows
from becalm.fleet.recipes import open_book
from becalm.fleet.sensor_cleaning import clean_whole
from made import Lake, Run, read_parts, recipe_of, same, without_spark
from shared_lakes import (
    BY_SENSOR,
    KEY,
    SPARK,
    as_a_file,
    cleaned,
    keyed,
    own_table,
    read_again,
    shuffled,
    states,
    together,
    write_files,
)

ROWS = 3000


@pytest.fixture(autouse=True)
def _no_spark(monkeypatch: pytest.MonkeyPatch) -> None:
    without_spark(monkeypatch)


def lake_of(place: Path, *tables: pa.Table, mode: Any = "causal") -> Lake:
    """Write rows as three files, and a recipe."""
    recipe = place / "r.toml"
    recipe.write_text(recipe_of("a", "b", mode=mode).to_toml(), encoding="utf-8")
    return Lake(write_files(place / "lake", pa.concat_tables(tables)), recipe)


def four(place: Path) -> Lake:
    """Write a lake of four sensors with their rows in no order."""
    return lake_of(place, shuffled([keyed(own_table(k, ROWS), f"pump {k}") for k in range(4)]))


def output_of(lake: Lake, sensor: str) -> pa.Table:
    return pq.read_table(lake.root.parent / "out" / sensor / "part-0.parquet", partitioning=None)


@pytest.mark.parametrize("mode", ["causal", "smoothed"])
def test_every_sensor_is_that_of_its_own_file_to_the_bit(tmp_path: Path, run: Run, mode: str) -> None:
    tables = [own_table(k, 400 + 40 * k) for k in range(20)]
    lake = lake_of(tmp_path, shuffled([keyed(table, f"pump {k:02d}") for k, table in enumerate(tables)]), mode=mode)
    assert states(cleaned(lake)) == {f"sensor=pump {k:02d}": "cleaned" for k in range(20)}
    for k in (7, 19):
        got, expected = output_of(lake, f"sensor=pump {k:02d}"), as_a_file(run, lake, tables[k])
        assert same(got, expected)
        assert got.schema.field("a").metadata == {b"unit": b"m"}
        assert got.schema.metadata[b"becalm.recipe"] == expected.schema.metadata[b"becalm.recipe"]


def test_sensors_may_be_called_anything(tmp_path: Path) -> None:
    names = ["a/b", "..", "", None, "Süd 1", "x=y", "007", "7"]
    lake = lake_of(tmp_path, together([keyed(own_table(k, 400), name) for k, name in enumerate(names)]))
    fleet = cleaned(lake)
    assert set(states(fleet)) == {
        "sensor=a%2Fb",
        "sensor=..",
        "sensor=",
        "sensor=__HIVE_DEFAULT_PARTITION__",
        "sensor=Süd 1",
        "sensor=x%3Dy",
        "sensor=007",
        "sensor=7",
    }
    assert set(states(fleet).values()) == {"cleaned"}
    assert output_of(lake, "sensor=007").column("a").to_pylist() != output_of(lake, "sensor=7").column("a").to_pylist()


def test_numbers_may_name_sensors_as_text_does_in_other_files(tmp_path: Path) -> None:
    lake = lake_of(tmp_path, keyed(own_table(1, 900), 7))
    late = own_table(1, 1200).slice(900)
    pq.write_table(keyed(late, "7"), lake.root / "late.parquet")
    assert states(cleaned(lake)) == {"sensor=7": "cleaned"}
    assert output_of(lake, "sensor=7").num_rows == 1200


def test_several_columns_tell_sensors_apart(tmp_path: Path) -> None:
    tables = [
        keyed(keyed(own_table(10 * plant + k, 500), f"s{k}"), plant, "plant") for plant in (1, 2) for k in range(2)
    ]
    lake = lake_of(tmp_path, shuffled(tables))
    fleet = cleaned(lake, BatchOptions(by="plant,sensor"))
    assert list(states(fleet)) == [f"plant={plant}/sensor=s{k}" for plant in (1, 2) for k in range(2)]
    assert "sensor" not in output_of(lake, "plant=1/sensor=s0").column_names


def test_a_second_run_reads_no_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake = four(tmp_path)
    cleaned(lake)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.parquet")}
    monkeypatch.setattr(cleaning, "split_rows", read_again)
    again = cleaned(lake)
    assert set(states(again).values()) == {"kept"}
    assert before == {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.parquet")}


def test_only_sensors_in_files_that_changed_are_cleaned_again(tmp_path: Path) -> None:
    lake = four(tmp_path)
    more = keyed(own_table(1, ROWS + 500).slice(ROWS), "pump 1")
    cleaned(lake)
    pq.write_table(more, lake.root / "more.parquet")
    assert {name for name, state in states(cleaned(lake)).items() if state == "cleaned"} == {"sensor=pump 1"}
    assert output_of(lake, "sensor=pump 1").num_rows == ROWS + 500
    assert {*states(cleaned(lake)).values()} == {"kept"}


def test_another_recipe_is_another_output(tmp_path: Path) -> None:
    lake = four(tmp_path)
    cleaned(lake)
    lake.recipe.write_text(recipe_of("a", "b", density=1.0).to_toml(), encoding="utf-8")
    assert {*states(cleaned(lake)).values()} == {"cleaned"}


def test_a_killed_job_goes_on_with_what_was_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake, done = four(tmp_path), list[str]()

    def killed(job: Any, sensor: Any) -> Any:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(sensor.name)
        return clean_whole(job, sensor)

    with monkeypatch.context() as patch:
        patch.setattr(cleaning, "clean_whole", killed)
        with pytest.raises(KeyboardInterrupt):
            cleaned(lake)
    assert {name for name, state in states(cleaned(lake)).items() if state == "kept"} == set(done)
    assert not list((tmp_path / "out").rglob("*.part"))
    assert not list((tmp_path / "out").rglob("*.strips"))


def test_rubbish_in_one_sensor_stops_nobody(tmp_path: Path) -> None:
    rubbish = keyed(own_table(8, 400), "no times")
    rubbish = rubbish.set_column(1, "time_s", pa.array(np.full(400, np.nan)))
    lake = lake_of(tmp_path, together([keyed(own_table(1, 400), "fine")]), rubbish)
    words = pa.table({KEY: ["text"] * 50, "time_s": np.arange(50) / 100, "a": ["x"] * 50, "b": ["y"] * 50})
    pq.write_table(words, lake.root / "words.parquet")
    pq.write_table(keyed(own_table(3, 50).drop_columns("a"), "other"), lake.root / "other.parquet")
    fleet = cleaned(lake)
    refused = {one.sensor: one.reason for one in fleet.outcomes if one.state == "refused"}
    assert sorted(refused) == ["sensor=no times", "sensor=other", "sensor=text"]
    assert states(fleet)["sensor=fine"] == "cleaned"
    assert "'a'" in refused["sensor=other"]
    for reason in refused.values():
        assert ".becalm" not in reason
        assert re.search(rf"^sensor=[a-z ]+ of {lake.root}: .*[.R]$|becalm tune FILE -o R.toml$", reason), reason


def test_a_damaged_file_refuses_only_the_sensors_in_it(tmp_path: Path) -> None:
    lake = lake_of(tmp_path, keyed(own_table(1, 400), "fine"))
    path = lake.root / "damaged.parquet"
    pq.write_table(keyed(own_table(2, 400), "hurt"), path, compression="none", use_dictionary=[KEY])
    content = bytearray(path.read_bytes())
    offset = pq.read_metadata(path).row_group(0).column(2).data_page_offset
    content[offset : offset + 40] = b"\xff" * 40
    path.write_bytes(content)
    fleet = cleaned(lake)
    assert states(fleet) == {"sensor=fine": "cleaned", "sensor=hurt": "refused"}
    assert str(path) in fleet.outcomes[1].reason


def test_a_file_that_tells_no_sensor_stops_the_job_before_it_begins(tmp_path: Path) -> None:
    lake = four(tmp_path)
    (lake.root / "torn.parquet").write_bytes(b"PAR1 and no end")
    with pytest.raises(InputError, match=r"torn\.parquet"):
        cleaned(lake)
    pq.write_table(own_table(1, 50), lake.root / "torn.parquet")
    with pytest.raises(InputError, match=r"torn\.parquet has no column 'sensor'"):
        cleaned(lake)
    (lake.root / "zz.parquet").write_bytes(b"PAR1 and no end")
    with pytest.raises(
        InputError, match=r"torn\.parquet has no column .* These files need repair as well: zz\.parquet\."
    ):
        cleaned(lake)
    assert not list((tmp_path / "out").rglob("*.parquet"))


def test_the_time_of_rows_tells_no_sensor(tmp_path: Path) -> None:
    lake = four(tmp_path)
    with pytest.raises(UsageError, match="--by 'time_s' names the time of the rows"):
        cleaned(lake, BatchOptions(by="time_s"))


def test_files_without_rows_are_no_lake(tmp_path: Path) -> None:
    lake = four(tmp_path)
    for path in lake.root.rglob("*.parquet"):
        pq.write_table(pq.read_table(path).slice(0, 0), path)
    with pytest.raises(InputError, match="holds a row; there is nothing to clean"):
        cleaned(lake)


def test_a_sensor_without_a_recipe_is_said(tmp_path: Path) -> None:
    lake = four(tmp_path)
    book = tmp_path / "book"
    book.mkdir()
    (book / "sensor=pump 2.toml").write_text(recipe_of("a").to_toml(), encoding="utf-8")
    fleet = clean(SPARK, lake.root, tmp_path / "out", open_book(recipes=book), BY_SENSOR)
    assert [name for name, state in states(fleet).items() if state == "cleaned"] == ["sensor=pump 2"]
    assert "add sensor=pump 1.toml" in {one.sensor: one.reason for one in fleet.outcomes}["sensor=pump 1"]


def test_a_file_that_changes_meanwhile_refuses_the_sensors_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lake = four(tmp_path)
    pq.write_table(keyed(own_table(9, 500), "late"), lake.root / "late.parquet")

    def after_a_change(*known: Any) -> Any:
        pq.write_table(keyed(own_table(9, 400), "late"), lake.root / "late.parquet")
        return split_rows(*known)

    with monkeypatch.context() as patch:
        patch.setattr(cleaning, "split_rows", after_a_change)
        fleet = cleaned(lake)
    assert {one.sensor: one.reason for one in fleet.outcomes if one.state == "refused"} == {
        "sensor=late": f"{lake.root / 'late.parquet'} changed while it was read; wait until it is complete, and repeat."
    }
    assert {one.sensor for one in cleaned(lake).outcomes if one.state == "cleaned"} == {"sensor=late"}


@pytest.mark.parametrize("by", ["pump", "sensor,plant"])
def test_a_column_that_is_not_there_is_said_with_those_that_are(tmp_path: Path, by: str) -> None:
    with pytest.raises(UsageError, match=r"there are a, b, note, sensor, time_s\."):
        cleaned(four(tmp_path), BatchOptions(by=by))


def test_a_long_sensor_is_put_together_and_then_cut_in_time(tmp_path: Path, run: Run) -> None:
    long = own_table(3, 30_000)
    lake = lake_of(tmp_path, shuffled([keyed(long, "long"), keyed(own_table(4, 500), "short")]))
    fleet = cleaned(lake, BatchOptions(by=KEY, stretch_rows=8192))
    assert {one.sensor: bool(one.seams) for one in fleet.outcomes} == {"sensor=long": True, "sensor=short": False}
    assert same(read_parts(tmp_path / "out" / "sensor=long"), as_a_file(run, lake, long))
    assert {*states(cleaned(lake, BatchOptions(by=KEY, stretch_rows=8192))).values()} == {"kept"}
    assert not list((tmp_path / "out").rglob("*.part"))


def test_the_lake_is_never_written_to(tmp_path: Path) -> None:
    lake = four(tmp_path)
    before = sorted((path, path.stat().st_mtime_ns) for path in lake.root.rglob("*"))
    cleaned(lake)
    assert before == sorted((path, path.stat().st_mtime_ns) for path in lake.root.rglob("*"))
