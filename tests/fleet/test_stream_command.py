"""`becalm fleet stream` as a person types it."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import becalm
from made import recipe_of, table_of, walk

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def lake(tmp_path: Path) -> Path:
    """Write a lake of two sensors, and a recipe."""
    for sensor in ("left", "right"):
        place = tmp_path / "lake" / f"sensor={sensor}"
        place.mkdir(parents=True)
        pq.write_table(table_of(np.arange(900) / 100, a=walk(len(sensor), 900)), place / "a.parquet")
    (tmp_path / "r.toml").write_text(recipe_of("a").to_toml(), encoding="utf-8")
    return tmp_path / "lake"


@pytest.mark.slow
@pytest.mark.spark
def test_what_is_there_is_streamed_and_what_comes_later_follows(lake: Path, run: Run, run_here: Run) -> None:
    """In a process of its own, then in this one."""
    words = ("fleet", "stream", lake, "--recipe", "r.toml", "--time", "time_s", "--once", "--master", "local[1]")
    for count, becalm_run in ((900, run), (1500, run_here)):
        ran = becalm_run(*words, "-o", "out")
        assert ran.returncode == 0, ran.stderr
        assert len(becalm.read(lake.parent / "out" / "kind=readings" / "sensor=left")) == count
        later = table_of(9 + np.arange(600) / 100, a=walk(3, 600))
        pq.write_table(later, lake / "sensor=left" / "b.parquet")
    ran = run_here(*words, "-o", lake / "out")
    assert ran.returncode == 2
    assert "would be read again" in ran.stderr
    assert not (lake / "out").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "--recipe R.toml"),
        (("--recipe", "r.toml", "--recipes", "."), "--recipe R.toml"),
        (("--recipe", "none.toml"), "none.toml"),
        (("--recipe", "r.toml", "--every", "soon"), "--every soon is not a time"),
        (("--recipe", "r.toml", "--lateness", "-5s"), "--lateness -5s is not a time"),
        (("--recipe", "r.toml", "--conf", "nothing"), "--conf nothing has no value"),
    ],
)
def test_what_cannot_be_is_said_before_spark_starts(lake: Path, run: Run, words: tuple[str, ...], said: str) -> None:
    ran = run("fleet", "stream", lake, "-o", "out", *words)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert said in ran.stderr
    assert "Traceback" not in ran.stderr
    assert not (lake.parent / "out").exists()
