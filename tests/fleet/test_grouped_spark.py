"""Sensors of shared files brought together on Spark: killed workers change nothing, and memory stays what it was."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import becalm
from becalm.fleet import spark_tasks
from becalm.fleet.batch import clean
from becalm.fleet.grouped import cleaning
from becalm.fleet.recipes import open_book
from made import Lake, Run, one_after_the_other, read_parts, recipe_of, same
from peak_memory import peak_mb
from shared_lakes import KEY, keyed, own_table, shuffled, write_files

pytestmark = [pytest.mark.slow, pytest.mark.spark]

SENSORS, ROWS = 20, 10_000


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """Write a lake of twenty sensors in three files, their rows in no order."""
    folder = tmp_path_factory.mktemp("shared")
    table = shuffled([keyed(own_table(k, ROWS), f"pump {k:02d}") for k in range(SENSORS)])
    (folder / "r.toml").write_text(recipe_of("a", "b").to_toml(), encoding="utf-8")
    return Lake(write_files(folder / "lake", table, row_group_size=25_000), folder / "r.toml")


@pytest.fixture(scope="module")
def whole(lake: Lake) -> Path:
    """Clean each sensor from a file of its own, in this very process."""
    root = lake.root.parent / "own"
    for k in range(SENSORS):
        write_files(root / f"sensor=pump {k:02d}", own_table(k, ROWS), 1)
    out = lake.root.parent / "whole"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("becalm.fleet.batch.run_tasks", one_after_the_other)
        fleet = clean(None, root, out, open_book(lake.recipe))  # type: ignore[arg-type]
    assert {one.state for one in fleet.outcomes} == {"cleaned"}
    return out


def as_of_their_own_files(out: Path, whole: Path) -> None:
    names = sorted(path.name for path in whole.glob("sensor=*"))
    assert sorted(path.name for path in out.glob("sensor=*")) == names
    for name in names:
        assert same(read_parts(out / name), read_parts(whole / name)), name
        assert len(becalm.read(out / name)) == ROWS
    assert not [path for path in out.rglob("*") if path.name.endswith((".part", ".strips"))]


STAGES = ("count_rows", "split_rows", "merge_and_clean")


def test_a_command_whose_workers_are_killed_gives_the_numbers_of_files(
    lake: Lake, whole: Path, tmp_path: Path, run_here: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two workers are killed amid their work at each stage, and Spark gives it to others."""

    def run_tasks(spark: Any, work: Callable[[Any], Any], tasks: Sequence[Any], **how: Any) -> list[Any]:
        stage = work.func.__name__  # type: ignore[attr-defined]
        killed = [str(tmp_path / f"killed {stage} {number}") for number in range(2)]

        def dies_twice(task: Any) -> Any:
            import os
            import signal
            import threading
            import time

            for name in killed:
                try:
                    os.close(os.open(name, os.O_CREAT | os.O_EXCL))
                except FileExistsError:
                    continue
                threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGKILL)).start()
                work(task)
                time.sleep(10)
            return work(task)

        return spark_tasks.run_tasks(spark, dies_twice, tasks, **how)

    monkeypatch.setattr(cleaning, "run_tasks", run_tasks)
    words = "fleet", "clean", lake.root, "-o", tmp_path / "out", "--recipe", lake.recipe, "--master", "local[2,4]"
    ran = run_here(*words, "--by", KEY)
    assert ran.returncode == 0, ran.stderr
    assert f"{SENSORS} of {SENSORS} sensors are cleaned" in ran.stderr
    names = {f"killed {stage} {number}" for stage in STAGES for number in range(2)}
    assert {path.name for path in tmp_path.glob("killed *")} == names
    as_of_their_own_files(tmp_path / "out", whole)
    ran = run_here(*words, "--by", "pump")
    assert (ran.returncode, ran.stdout) == (2, "")
    assert "there are a, b, note, sensor, time_s." in ran.stderr


MEASURED = """
import pathlib, sys
from becalm.fleet.batch import BatchOptions, clean
from becalm.fleet.grouped import cleaning
from becalm.fleet.recipes import open_book
cleaning.run_tasks = lambda spark, work, tasks, lost: [work(task) for task in tasks]
lake, out, recipe = map(pathlib.Path, sys.argv[1:])
fleet = clean(None, lake, out, open_book(recipe), BatchOptions(by="sensor", stretch_rows=1 << 30))
assert [one.state for one in fleet.outcomes] == ["cleaned"], fleet.outcomes
"""


@pytest.mark.parametrize("order", ["shuffled", "in order"])
def test_memory_does_not_grow_with_a_sensor(tmp_path: Path, order: str) -> None:
    (tmp_path / "r.toml").write_text(recipe_of("a").to_toml(), encoding="utf-8")
    rng, peaks = np.random.default_rng(2), []
    for millions in (2, 9):  # a million is done before all that is held at once is there
        rows = millions * 1_000_000
        at = rng.permutation(rows) if order == "shuffled" else np.arange(rows)
        reading = pa.field("a", pa.float64(), metadata={b"unit": b"m"})
        schema = pa.schema([pa.field(KEY, pa.string()), pa.field("time_s", pa.float64()), reading])
        folder = tmp_path / f"lake {millions}"
        folder.mkdir()
        with pq.ParquetWriter(folder / "in.parquet", schema) as writer:
            for part in np.split(at, millions):
                names = pa.DictionaryArray.from_arrays(np.zeros(len(part), np.int8), ["x"]).cast(pa.string())
                writer.write_table(pa.table([names, part / 1000, rng.normal(size=len(part))], schema=schema))
        peaks.append(peak_mb(MEASURED, folder, tmp_path / f"out {millions}", tmp_path / "r.toml"))
    assert peaks[1] < peaks[0] + 100, peaks  # MB; the further rows would be 160, at each of several steps
    assert peaks[1] < 800, peaks
