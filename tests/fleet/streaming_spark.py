"""Streams through Spark in tests: a session, a stage of lake and output, and what is told there."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pytest

from becalm.core.reading_verdicts import Verdict
from becalm.fleet.session import session
from becalm.fleet.stream import LiveBook, SensorPlan, StreamPlan, run, wait
from becalm.fleet.stream.blocks import SensorRows
from fleet_stream_runs import committed, told_in, write_rows
from streaming import CHANNELS, RECIPE, Said

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

__all__ = ["committed", "told_in"]


@pytest.fixture(scope="module")
def spark(quick_spark: None) -> Iterator[SparkSession]:
    """Give Spark in this process."""
    with session("local[2]", {"spark.sql.shuffle.partitions": "2", "spark.default.parallelism": "2"}) as running:
        yield running


class Stage:
    """A lake, a recipe, an output."""

    def __init__(self, folder: Path, spark: SparkSession) -> None:
        self.lake, self.out, self.recipe = folder / "lake", folder / "out", folder / "r.toml"
        self._spark = spark
        self.recipe.write_text(RECIPE.to_toml(), encoding="utf-8")

    def plan(self, sensors: dict[str, Any] | None = None, **how: Any) -> StreamPlan:
        """Return a plan over them."""
        book = LiveBook(self.recipe)
        source = how.pop("source", str(self.lake))
        return StreamPlan(source, str(self.out), SensorPlan(book, **(sensors or {})), partitions=2, **how)

    def once(self, source: str = "", **sensors: Any) -> None:
        """Stream what is there now."""
        how = {"source": source} if source else {}
        wait(run(self._spark, self.plan(sensors, once=True, **how)))

    def write(self, name: str, rows: SensorRows, **how: Any) -> None:
        """Let a file come."""
        channels = {name: rows.values[:, c] for c, name in enumerate(CHANNELS)}
        write_rows(self.lake / name, rows.time_s, channels, **how)


@pytest.fixture
def stage(tmp_path: Path, spark: SparkSession) -> Stage:
    """Give an empty one."""
    return Stage(tmp_path, spark)


def said_in(table: pa.Table) -> Said:
    """Return what a table of readings says, as a walker does."""
    words = [verdict.name.lower() for verdict in Verdict]
    stamps = table["time"]
    seconds = stamps.to_numpy() if stamps.type == pa.float64() else stamps.cast(pa.int64()).to_numpy() / 1e6
    signal, sigma = (np.column_stack([table[name + end].to_numpy() for name in CHANNELS]) for end in ("", "_sigma"))
    verdicts = [[words.index(word) for word in table[f"{name}_verdict"].to_pylist()] for name in CHANNELS]
    return Said(seconds, signal, sigma, np.array(verdicts, np.int8).T)


def events_of(out: Path, sensor: str) -> list[str]:
    """Return the kinds of what befell a sensor so far."""
    log = out / "_spark_metadata"
    if not log.exists() or not any(f"kind=events/sensor={sensor}/" in str(path) for path in committed(out)):
        return []
    return list(told_in(out, sensor, "events")["event"].to_pylist())


def until(is_so: Callable[[], bool], deadline_s: float = 60.0) -> None:
    """Wait for something."""
    end = time.monotonic() + deadline_s
    while not is_so():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.3)
