"""A lake cleaned: the numbers of a file, whole or not at all, and no sensor stops the others."""

from __future__ import annotations

import json
import os
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import becalm
from becalm.cleaning.recipes.recipe import Mode
from becalm.errors import InputError, UsageError
from becalm.fleet.batch import BatchOptions, Fleet, clean
from becalm.fleet.recipes import open_book
from becalm.live.locking import lock_file
from made import Lake, Run, farthest, read_parts, recipe_of, same, table_of, walk, without_spark, write_parts

SPARK: Any = None


@pytest.fixture
def lake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lake:
    """Write a lake of four sensors in three files each, and jobs that need no Spark."""
    without_spark(monkeypatch)
    for sensor in range(4):
        rows = 6000
        times_s = np.arange(rows) / 100 + (3.0 * (np.arange(rows) > 4000) if sensor == 2 else 0.0)
        table = table_of(times_s, a=walk(sensor, rows, holes=3 * (sensor > 0)), b=walk(sensor + 9, rows))
        write_parts(tmp_path / "lake" / f"sensor={sensor}", table, (1000, 4321))
    recipe = tmp_path / "r.toml"
    recipe.write_text(recipe_of("a", "b").to_toml(), encoding="utf-8")
    return Lake(tmp_path / "lake", recipe)


def cleaned(lake: Lake, asked: BatchOptions = BatchOptions()) -> Fleet:  # noqa: B008  (it cannot change)
    return clean(SPARK, lake.root, lake.root.parent / "out", open_book(lake.recipe), asked)


def as_a_file(run: Run, lake: Lake, sensor: str) -> pa.Table:
    """Clean a sensor as `becalm clean` does."""
    out = lake.root.parent / "one.parquet"
    ran = run("clean", lake.root / sensor, "-o", out, "--recipe", lake.recipe, "--verdicts")
    assert ran.returncode in (0, 4), ran.stderr
    return pq.read_table(out)


def test_every_sensor_is_that_of_a_file_to_the_bit(lake: Lake, run: Run) -> None:
    fleet = cleaned(lake)
    assert [(one.sensor, one.state) for one in fleet.outcomes] == [(f"sensor={k}", "cleaned") for k in range(4)]
    for sensor in ("sensor=0", "sensor=2"):
        assert same(read_parts(lake.root.parent / "out" / sensor), as_a_file(run, lake, sensor))


def test_there_is_an_output_for_each_input_with_sigma_verdicts_and_recipe(lake: Lake) -> None:
    cleaned(lake)
    out = lake.root.parent / "out"
    names = [path.relative_to(lake.root) for path in sorted(lake.root.rglob("*.parquet"))]
    assert [path.relative_to(out) for path in sorted(out.rglob("*.parquet"))] == names
    table = pq.read_table(out / names[0], partitioning=None)
    assert table.column_names == ["time_s", "a", "a_sigma", "a_verdict", "b", "b_sigma", "b_verdict", "note"]
    assert table.schema.metadata[b"becalm.recipe"].decode() == lake.recipe.read_text(encoding="utf-8")
    assert table.num_rows == pq.read_metadata(lake.root / names[0]).num_rows


def test_a_second_run_leaves_what_is_finished(lake: Lake) -> None:
    cleaned(lake)
    out = lake.root.parent / "out"
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}
    again = cleaned(lake)
    assert {one.state for one in again.outcomes} == {"kept"}
    assert before == {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}
    assert [row.noise_std for row in again.rows] == [1.0] * 8


@pytest.mark.parametrize("change", ["rows", "recipe", "mode", "output gone", "output cut", "file gone"])
def test_what_has_changed_is_made_anew(lake: Lake, change: str) -> None:
    cleaned(lake)
    out, place = lake.root.parent / "out" / "sensor=1", lake.root / "sensor=1" / "date=2026-01-02" / "part-8.parquet"
    asked, changed = BatchOptions(), {"sensor=1"}
    if change == "rows":  # of the same size, between the same extremes
        table = pq.read_table(place, partitioning=None)
        flipped = table.set_column(1, table.schema.field(1), table.column(1).take(np.arange(table.num_rows)[::-1]))
        pq.write_table(flipped, place)
    elif change == "recipe":
        lake.recipe.write_text(recipe_of("a", "b", density=1.0).to_toml(), encoding="utf-8")
        changed = {f"sensor={k}" for k in range(4)}
    elif change == "mode":
        lake.recipe.write_text(recipe_of("a", "b", mode="smoothed").to_toml(), encoding="utf-8")
        cleaned(lake)
        asked, changed = BatchOptions(causal=True), {f"sensor={k}" for k in range(4)}
    elif change == "output gone":
        next(out.rglob("*.parquet")).unlink()
    elif change == "output cut":
        os.truncate(next(out.rglob("*.parquet")), 100)
    else:
        place.unlink()
    assert {one.sensor for one in cleaned(lake, asked).outcomes if one.state == "cleaned"} == changed
    names = {path.relative_to(out) for path in out.rglob("*.parquet")}
    assert names == {path.relative_to(lake.root / "sensor=1") for path in (lake.root / "sensor=1").rglob("*.parquet")}


def test_rubbish_is_reported_and_stops_nobody(lake: Lake) -> None:
    rubbish = {
        "sensor=cut": b"PAR1 and no end",
        "sensor=empty": b"",
    }
    for name, content in rubbish.items():
        (lake.root / name).mkdir()
        (lake.root / name / "a.parquet").write_bytes(content)
    (lake.root / "sensor=backwards").mkdir()
    backwards = table_of(np.arange(100)[::-1] / 100, a=walk(1, 100), b=walk(2, 100))
    pq.write_table(backwards, lake.root / "sensor=backwards" / "a.parquet")
    (lake.root / "sensor=other").mkdir()
    pq.write_table(table_of(np.arange(100) / 100, c=walk(1, 100)), lake.root / "sensor=other" / "a.parquet")
    (lake.root / "sensor=gone").mkdir()
    (lake.root / "sensor=gone" / "a.parquet").symlink_to(lake.root / "nowhere")
    (lake.root / "sensor=text").mkdir()
    words = pa.table({"time_s": np.arange(100) / 100, "a": ["x"] * 100, "b": ["y"] * 100})
    pq.write_table(words, lake.root / "sensor=text" / "a.parquet")
    fleet = cleaned(lake)
    refused = {one.sensor: one.reason for one in fleet.outcomes if one.state == "refused"}
    assert sorted(refused) == [f"sensor={name}" for name in ("backwards", "cut", "empty", "gone", "other", "text")]
    assert "backwards" in refused["sensor=backwards"]
    assert "'a'" in refused["sensor=other"]
    assert all(reason.endswith((".", "DIR")) and "Error" not in reason for reason in refused.values()), refused
    assert "4 of 10 sensors are cleaned" in fleet.summary
    assert not list((lake.root.parent / "out").rglob("*.part"))


def test_a_bug_is_a_reason_too(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("of a kind nobody thought of")

    monkeypatch.setattr("becalm.fleet.sensor_cleaning.clean_chunks", broken)
    assert {one.reason for one in cleaned(lake).outcomes} == {"ZeroDivisionError: of a kind nobody thought of"}
    assert not list((lake.root.parent / "out").rglob("*.parquet"))


def test_the_job_is_told_in_a_page_and_in_lines(lake: Lake) -> None:
    fleet = cleaned(lake)
    about = lake.root.parent / "out" / "_becalm"
    lines = (about / "outcomes.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["sensor"] for line in lines] == [f"sensor={k}" for k in range(4)]
    assert fleet.report == about / "report.html"
    page = fleet.report.read_text(encoding="utf-8")
    assert "<html" in page
    assert "24\u202f000" in page  # rows


def test_each_file_may_be_a_sensor(tmp_path: Path, lake: Lake) -> None:
    flat = tmp_path / "flat"
    (flat / "deep").mkdir(parents=True)
    for name in ("one", "deep/two"):
        pq.write_table(table_of(np.arange(3000) / 100, a=walk(3, 3000), b=walk(4, 3000)), flat / f"{name}.parquet")
    fleet = clean(SPARK, flat, tmp_path / "out", open_book(lake.recipe), BatchOptions(by="file"))
    assert [one.sensor for one in fleet.outcomes] == ["deep/two.parquet", "one.parquet"]
    one, two = (pq.read_table(tmp_path / "out" / f"{name}.parquet") for name in ("one", "deep/two"))
    assert same(one, two)
    again = clean(SPARK, flat, tmp_path / "out", open_book(lake.recipe), BatchOptions(by="file"))
    assert {one.state for one in again.outcomes} == {"kept"}


def test_the_lake_is_never_written_to(lake: Lake) -> None:
    for output in (lake.root, lake.root / "out", lake.root.parent):
        with pytest.raises(UsageError, match="overlaps the lake"):
            clean(SPARK, lake.root, output, open_book(lake.recipe))
    before = sorted((path, path.stat().st_mtime_ns) for path in lake.root.rglob("*"))
    cleaned(lake)
    assert before == sorted((path, path.stat().st_mtime_ns) for path in lake.root.rglob("*"))


def test_an_output_that_cannot_be_made_is_said(lake: Lake) -> None:
    (lake.root.parent / "taken").write_text("a file", encoding="utf-8")
    with pytest.raises(UsageError, match="cannot be made"):
        clean(SPARK, lake.root, lake.root.parent / "taken" / "out", open_book(lake.recipe))


def test_no_lake_is_said(tmp_path: Path, lake: Lake) -> None:
    (tmp_path / "nothing").mkdir()
    with pytest.raises(InputError, match="not a folder"):
        clean(SPARK, tmp_path / "nowhere", tmp_path / "out", open_book(lake.recipe))
    with pytest.raises(InputError, match=r"nothing is a directory; give the path of .* a folder with Parquet files"):
        clean(SPARK, tmp_path / "nothing", tmp_path / "out2", open_book(lake.recipe))


@pytest.mark.parametrize("mode", ["causal", "smoothed"])
def test_a_long_sensor_cut_in_time_is_that_of_a_file(lake: Lake, run: Run, mode: Mode) -> None:
    rows = 60_000
    times_s = np.arange(rows) / 100
    times_s[40_000:] += 12.0
    table = table_of(times_s, a=walk(77, rows, holes=20), b=walk(78, rows))
    write_parts(lake.root / "sensor=long", table, (10_000, 25_001), row_group_size=8192)
    lake.recipe.write_text(recipe_of("a", "b", mode=mode).to_toml(), encoding="utf-8")
    fleet = cleaned(lake, BatchOptions(stretch_rows=8192))
    (long,) = [one for one in fleet.outcomes if one.sensor == "sensor=long"]
    assert long.seams.startswith("6 stretches" if mode == "causal" else "7 stretches"), long
    assert {row.rows for row in long.channels} == {rows}
    own, its = read_parts(lake.root.parent / "out" / "sensor=long"), as_a_file(run, lake, "sensor=long")
    if mode == "causal":
        assert same(own, its)
    else:
        assert own.column("a_verdict").cast(pa.string()).equals(its.column("a_verdict").cast(pa.string()))
        assert max(farthest(own, its, name) for name in ("a", "a_sigma", "b", "b_sigma")) < 1e-10
    again = cleaned(lake, BatchOptions(stretch_rows=8192))
    assert {one.state for one in again.outcomes} == {"kept"}


def test_a_long_sensor_of_uneven_time_is_that_of_a_file(lake: Lake, run: Run) -> None:
    rows = 30_000
    times_s = np.cumsum(np.random.default_rng(6).uniform(0.008, 0.012, rows))
    write_parts(lake.root / "sensor=long", table_of(times_s, a=walk(5, rows, 5), b=walk(6, rows)), (7000,))
    (long,) = [one for one in cleaned(lake, BatchOptions(stretch_rows=8192)).outcomes if one.sensor == "sensor=long"]
    assert long.seams.startswith("3 stretches"), long
    assert same(read_parts(lake.root.parent / "out" / "sensor=long"), as_a_file(run, lake, "sensor=long"))


def test_one_job_at_a_time_has_an_output(lake: Lake) -> None:
    out = lake.root.parent / "out"
    (out / "_becalm").mkdir(parents=True)
    with closing(lock_file(out / "_becalm" / "lock", "")), pytest.raises(UsageError, match="Another job is at work"):
        cleaned(lake)
    assert {one.state for one in cleaned(lake).outcomes} == {"cleaned"}


def test_what_a_killed_job_left_goes(lake: Lake) -> None:
    left = lake.root.parent / "out" / "sensor=1" / ".becalm.0123.part" / "date=2026-01-01"
    left.mkdir(parents=True)
    (left / "part-9.parquet").write_bytes(b"half")
    cleaned(lake)
    assert not list((lake.root.parent / "out").rglob("*.part"))


@pytest.mark.parametrize("done", [0, 1, 2])
def test_what_is_killed_while_it_appears_is_not_read(lake: Lake, monkeypatch: pytest.MonkeyPatch, done: int) -> None:
    """Some files have their names already: none of them counts before all have."""
    renamed, real = [0], Path.replace

    def killed(path: Path, target: Path) -> Path:
        if "sensor=1" in str(target) and target.suffix == ".parquet" and ".part" not in str(target):
            if renamed[0] == done:
                raise KeyboardInterrupt
            renamed[0] += 1
        return real(path, target)

    monkeypatch.setattr(Path, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        cleaned(lake)
    monkeypatch.undo()
    without_spark(monkeypatch)
    out = lake.root.parent / "out" / "sensor=1"
    with pytest.raises(InputError):
        becalm.read(out)
    cleaned(lake)
    assert len(becalm.read(out)) == 6000
