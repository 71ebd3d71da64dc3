"""Commands take a folder of Parquet files as they take a file."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.files.inputs.opening import open_source

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def lake(tmp_path: Path) -> Path:
    """Write a file of 600 rows, and a folder with the same rows in three files whose names are in no order."""
    rng = np.random.default_rng(3)
    walk = np.cumsum(rng.normal(0, 0.1, 600)) + rng.normal(0, 0.2, 600)
    table = pa.table({"time_s": np.arange(600) / 100, "walk": walk, "note": [f"gear {k // 100}" for k in range(600)]})
    pq.write_table(table, tmp_path / "whole.parquet")
    lake = tmp_path / "lake"
    for number, name in enumerate(("date=2/b", "date=1/z", "date=1/a")):
        (lake / name).parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table.slice(200 * number, 200), lake / f"{name}.parquet")
    return lake


def test_a_folder_is_cleaned_as_the_file_is_that_holds_its_rows(lake: Path, run: Run, tmp_path: Path) -> None:
    for source, output in ((lake, "calm.parquet"), (tmp_path / "whole.parquet", "other.parquet")):
        ran = run("clean", source, "-o", output, "--verdicts")
        assert ran.returncode == 0, ran.stderr
    assert pq.read_table(tmp_path / "calm.parquet") == pq.read_table(tmp_path / "other.parquet")
    with open_source(lake) as opened:
        assert opened.sha256() in (tmp_path / "calm.parquet.recipe.toml").read_text(encoding="utf-8")


def test_a_folder_is_inspected_and_tuned_on(lake: Path, run: Run, tmp_path: Path) -> None:
    ran = run("inspect", lake, "--json")
    assert ran.returncode == 0, ran.stderr
    told = json.loads(ran.stdout)
    assert told["rows"] == 600
    ran = run("tune", lake, "-o", "r.toml")
    assert ran.returncode == 0, ran.stderr
    ran = run("clean", lake, "-o", "calm.csv", "--recipe", "r.toml")
    assert ran.returncode == 0, ran.stderr


def test_a_table_is_not_written_into_the_folder_that_is_read(lake: Path, run: Run) -> None:
    before = sorted(lake.rglob("*"))
    ran = run("clean", lake, "-o", lake / "date=3" / "calm.Parquet")
    assert ran.returncode == 2
    assert f"calm.Parquet is in {lake}, and would be read as a part of it. Give another with -o." in ran.stderr
    assert sorted(lake.rglob("*")) == before


def test_several_sensors_and_no_parquet_are_told_in_a_sentence(lake: Path, run: Run, tmp_path: Path) -> None:
    (lake / "date=1").rename(lake / "sensor=1")
    (lake / "date=2").rename(lake / "sensor=2")
    ran = run("clean", lake, "-o", "calm.parquet")
    assert ran.returncode == 3
    assert f"{lake} holds several sensors: sensor=1, sensor=2; name one: becalm clean {lake}/sensor=1 -o" in ran.stderr
    (tmp_path / "empty").mkdir()
    ran = run("inspect", tmp_path / "empty")
    assert ran.returncode == 3
    assert "empty is a directory; give the path of one file in it" in ran.stderr
    assert not (tmp_path / "calm.parquet").exists()
