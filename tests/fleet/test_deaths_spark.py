"""A sensor of which every worker dies: the others are cleaned, and it is named."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from becalm.errors import UsageError
from becalm.fleet import batch, spark_tasks
from becalm.fleet.batch import clean
from becalm.fleet.recipes import open_book
from becalm.fleet.session import session
from made import recipe_of, table_of, walk, write_parts

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

pytestmark = [pytest.mark.slow, pytest.mark.spark]

DEADLY = "sensor=3"


@pytest.fixture(scope="module")
def spark(quick_spark: None) -> Iterator[SparkSession]:
    """Give Spark that tries nothing twice."""
    with session("local[2,1]") as running:
        yield running


def test_a_sensor_that_its_workers_die_of_stops_nobody(
    spark: SparkSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for sensor in range(6):
        write_parts(tmp_path / "lake" / f"sensor={sensor}", table_of(np.arange(2000) / 100, a=walk(sensor, 2000)))
    (tmp_path / "r.toml").write_text(recipe_of("a").to_toml(), encoding="utf-8")

    def run_tasks(spark: Any, work: Callable[[Any], Any], tasks: Sequence[Any], *how: Any) -> list[Any]:
        def dies(task: Any) -> Any:
            if task.name == DEADLY:
                os.kill(os.getpid(), signal.SIGKILL)
            return work(task)

        return spark_tasks.run_tasks(spark, dies, tasks, *how)

    monkeypatch.setattr(batch, "run_tasks", run_tasks)
    fleet = clean(spark, tmp_path / "lake", tmp_path / "out", open_book(tmp_path / "r.toml"))
    assert {one.sensor: one.state == "refused" for one in fleet.outcomes} == {
        f"sensor={sensor}": f"sensor={sensor}" == DEADLY for sensor in range(6)
    }
    assert {one.state for one in fleet.outcomes if one.sensor != DEADLY} == {"cleaned"}  # and by no earlier job
    (lost,) = [one for one in fleet.outcomes if one.sensor == DEADLY]
    assert lost.reason.startswith("Every process that worked on it died. It may need more memory")
    assert lost.reason in (fleet.report.parent / "outcomes.jsonl").read_text(encoding="utf-8")


def doing(what: str) -> Callable[[int], int]:
    """Return work of which its worker dies, or which raises; by its value, for workers do not know this file."""

    def work(task: int) -> int:
        if what == "dies":
            os.kill(os.getpid(), signal.SIGKILL)
        raise ValueError(f"{task} is rubbish")

    return work


def lost(task: int, why: str) -> int:
    assert "died" in why
    return -task


def test_where_all_die_the_job_ends(spark: SparkSession, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spark_tasks, "_MOST_DEATHS", 1)
    with pytest.raises(UsageError, match=r"Spark gave the job up \(.*worker exited unexpectedly"):
        spark_tasks.run_tasks(spark, doing("dies"), [1, 2, 3], lost=lost)


def test_where_spark_itself_is_gone_the_job_ends(spark: SparkSession, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object, **__: object) -> None:
        raise ConnectionRefusedError(111, "Connection refused")

    monkeypatch.setattr(type(spark), "range", gone)
    with pytest.raises(UsageError, match=r"Spark gave the job up \(.*Connection refused"):
        spark_tasks.run_tasks(spark, doing("raises"), [1], lost=lost)


@pytest.mark.skipif(os.name != "posix", reason="signals of pipes are POSIX's")
def test_a_worker_whose_jvm_is_gone_dies_without_a_word(spark: SparkSession) -> None:
    def work(task: int) -> bool:
        return signal.getsignal(signal.SIGPIPE) is signal.SIG_DFL

    spark_tasks.run_tasks(spark, work, [1, 2])
    assert any(spark_tasks.run_tasks(spark, work, [1, 2]))  # of the same workers, which Spark keeps


def test_what_is_no_death_ends_it_at_once(spark: SparkSession) -> None:
    with pytest.raises(UsageError, match=r"Spark gave the job up \(.*1 is rubbish"):
        spark_tasks.run_tasks(spark, doing("raises"), [1], lost=lost)
    with pytest.raises(UsageError, match="worker exited unexpectedly"):
        spark_tasks.run_tasks(spark, doing("dies"), [1])
