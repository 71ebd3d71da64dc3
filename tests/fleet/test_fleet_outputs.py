"""What lies where a sensor's output goes: written over only where becalm wrote it, and gone when it is older."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import becalm
from becalm.errors import OutputError
from becalm.files.outputs.chunked_cleaning import clean_chunks
from becalm.fleet.batch import BatchOptions, Fleet, clean
from becalm.fleet.job import Job
from becalm.fleet.marks import CompletionMark
from becalm.fleet.recipes import open_book
from made import Lake, recipe_of, table_of, walk, without_spark, write_parts

SPARK: Any = None
ROWS = 6000


@pytest.fixture
def lake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lake:
    without_spark(monkeypatch)
    for sensor in range(2):
        write_parts(
            tmp_path / "lake" / f"sensor={sensor}", table_of(np.arange(ROWS) / 100, a=walk(sensor, ROWS)), (999,)
        )
    (tmp_path / "r.toml").write_text(recipe_of("a").to_toml(), encoding="utf-8")
    return Lake(tmp_path / "lake", tmp_path / "r.toml")


def out_of(lake: Lake) -> Path:
    return lake.root.parent / "out"


def cleaned(lake: Lake, asked: BatchOptions = BatchOptions()) -> Fleet:  # noqa: B008  (it cannot change)
    return clean(SPARK, lake.root, out_of(lake), open_book(lake.recipe), asked)


def reasons(fleet: Fleet) -> list[str]:
    return [one.reason for one in fleet.outcomes]


@pytest.mark.parametrize("asked", [BatchOptions(), BatchOptions(stretch_rows=1024)], ids=["whole", "cut"])
def test_files_of_others_are_not_written_over(lake: Lake, asked: BatchOptions) -> None:
    foreign = out_of(lake) / "sensor=1" / "date=2026-01-02" / "part-8.parquet"
    foreign.parent.mkdir(parents=True)
    foreign.write_bytes(b"of somebody else")
    said = reasons(cleaned(lake, asked))
    assert said[0] == ""
    assert said[1].startswith(f"{foreign} exists already, and no mark shows that becalm wrote it")
    assert foreign.read_bytes() == b"of somebody else"
    foreign.unlink()
    assert reasons(cleaned(lake, asked)) == ["", ""]


def test_of_two_sensors_in_one_folder_the_second_does_not_overwrite_the_first(
    lake: Lake, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows and macOS take folders whose names differ only in case for one."""
    monkeypatch.setattr(Job, "output_folder", lambda job, _: Path(job.output) / "sensor=x")
    said = reasons(cleaned(lake))
    assert said[0] == ""
    assert "exists already, and no mark shows that becalm wrote it" in said[1]


def test_a_damaged_mark_is_no_leave_to_write_over(lake: Lake) -> None:
    cleaned(lake)
    (out_of(lake) / "sensor=1" / "_becalm.json").write_text('{"files": [', encoding="utf-8")
    assert "no mark shows that becalm wrote it; remove it" in reasons(cleaned(lake))[1]


def test_a_link_leads_nobody_to_raw_files(lake: Lake) -> None:
    out_of(lake).mkdir()
    (out_of(lake) / "sensor=1").symlink_to(lake.root / "sensor=1")
    before = sorted((path, path.stat().st_mtime_ns) for path in lake.root.rglob("*"))
    assert "out of the output; remove that link" in reasons(cleaned(lake))[1]
    assert before == sorted((path, path.stat().st_mtime_ns) for path in lake.root.rglob("*"))


def test_nor_does_one_below_a_sensor(lake: Lake) -> None:
    cleaned(lake)
    day = out_of(lake) / "sensor=1" / "date=2026-01-02"
    shutil.rmtree(day)
    day.symlink_to(lake.root / "sensor=1" / "date=2026-01-02")
    before = sorted((path, path.stat().st_mtime_ns) for path in lake.root.rglob("*"))
    assert f"{day} leads to " in reasons(cleaned(lake))[1]
    assert before == sorted((path, path.stat().st_mtime_ns) for path in lake.root.rglob("*"))


@pytest.mark.parametrize("asked", [BatchOptions(), BatchOptions(stretch_rows=1024)], ids=["whole", "cut"])
def test_a_column_in_whose_place_an_uncertainty_is_written_is_named(lake: Lake, asked: BatchOptions) -> None:
    (path,) = (lake.root / "sensor=1" / "date=2026-01-01").glob("*.parquet")
    shutil.rmtree(lake.root / "sensor=1" / "date=2026-01-02")
    table = table_of(np.arange(ROWS) / 100, a=walk(1, ROWS))
    pq.write_table(table.append_column("a_sigma", pa.array(np.full(ROWS, 0.1))), path)
    for outcome in cleaned(lake, asked).outcomes:
        assert ("Replaced by the new uncertainty: a_sigma." in outcome.channels[0].says) == (
            outcome.sensor == "sensor=1"
        )
    lake.recipe.write_text(recipe_of("a", "a_sigma").to_toml(), encoding="utf-8")
    assert "'a_sigma' has the name under which the uncertainty of 'a' is written" in reasons(cleaned(lake, asked))[1]


@pytest.mark.parametrize("killed_at", ["renames", "older", "mark"])
def test_files_of_an_older_output_go_whenever_it_is_killed(
    lake: Lake, monkeypatch: pytest.MonkeyPatch, killed_at: str
) -> None:
    cleaned(lake)
    folder = lake.root / "sensor=1" / "date=2026-01-01"
    (folder / "part-9.parquet").rename(folder / "another.parquet")
    with monkeypatch.context() as patch:
        _kill(patch, killed_at)
        with pytest.raises(KeyboardInterrupt):
            cleaned(lake)
    assert {one.state for one in cleaned(lake).outcomes} == {"kept", "cleaned"}
    out = out_of(lake) / "sensor=1"
    assert sorted(path.name for path in out.rglob("*.parquet")) == ["another.parquet", "part-8.parquet"]
    assert len(becalm.read(out)) == ROWS
    assert not list(out_of(lake).rglob("*.part"))


def _kill(patch: pytest.MonkeyPatch, at: str) -> None:
    def killed(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    if at == "renames":
        patch.setattr("becalm.fleet.sensor_cleaning.put_in_place", killed)
    elif at == "older":
        patch.setattr(Path, "unlink", killed)
    else:
        written, real = [0], CompletionMark.write

        def second(mark: CompletionMark, path: Path) -> None:
            written[0] += 1
            killed() if written[0] == 2 else real(mark, path)

        patch.setattr(CompletionMark, "write", second)


def test_a_file_that_comes_meanwhile_is_told(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    def arrives(*words: Any, **more: Any) -> Any:
        found = clean_chunks(*words, **more)
        write_parts(lake.root / "sensor=0" / "year=2025", table_of(np.arange(10) / 100 - 5, a=walk(3, 10)))
        return found

    lake.root.joinpath("sensor=1").rename(lake.root.parent / "elsewhere")
    with monkeypatch.context() as patch:
        patch.setattr("becalm.fleet.sensor_cleaning.clean_chunks", arrives)
        (said,) = reasons(cleaned(lake))
    assert said == "The files of sensor=0 changed while they were read; wait until all have arrived, and repeat."
    assert not list(out_of(lake).rglob("*.parquet"))
    assert reasons(cleaned(lake)) == [""]


def test_a_refused_sensor_says_where_its_older_output_is(lake: Lake) -> None:
    cleaned(lake)
    next((lake.root / "sensor=1").rglob("part-9.parquet")).write_bytes(b"PAR1 and no end")
    assert reasons(cleaned(lake))[1].endswith(f"An older output is still in {out_of(lake) / 'sensor=1'}.")


def test_names_without_an_ending_are_written_as_parquet(lake: Lake) -> None:
    for path in list(lake.root.rglob("*.parquet")):
        path.rename(path.with_name("000000_0"))
    assert reasons(cleaned(lake)) == ["", ""]
    assert pq.read_metadata(out_of(lake) / "sensor=0" / "date=2026-01-01" / "000000_0").num_rows == 999
    assert len(becalm.read(out_of(lake) / "sensor=0")) == ROWS


def test_what_was_found_of_files_and_clocks_is_told(lake: Lake) -> None:
    folder = lake.root / "sensor=1"
    named = [str(path.relative_to(folder)) for path in folder.rglob("*.parquet")]
    (folder / "_becalm.json").write_text(json.dumps({"files": [*named, "gone.parquet"]}), encoding="utf-8")
    (row,) = [row for row in cleaned(lake).rows if row.sensor == "sensor=1"]
    assert "One file is missing that the log of" in row.says
    assert "the rows in them are missing" in row.says


def test_an_output_that_cannot_be_locked_is_said(lake: Lake) -> None:
    (out_of(lake) / "_becalm" / "lock").mkdir(parents=True)
    with pytest.raises(OutputError, match="cannot be locked"):
        cleaned(lake)
