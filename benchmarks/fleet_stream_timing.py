"""Time streams over a fleet: write a lake, stream it in micro-batches, and read the processor time of each."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from pyspark import cloudpickle

from becalm.fleet.stream import LiveBook, SensorPlan, StreamPlan, query, sources
from becalm.fleet.stream.columns import ANSWER, StreamSchema
from becalm.fleet.stream.output_batches import to_output_batches
from becalm.fleet.stream.processor import SensorProcessor
from becalm.fleet.stream.sensor import SensorStreamProcessor
from fleet_stream_kills import CHANNELS, NAMES, RATE_HZ, RECIPE
from fleet_stream_runs import below, write_rows
from live_runs import readings

if TYPE_CHECKING:
    from pyspark.sql import DataFrame, SparkSession

_BEGINS_S, _TICKS = 1.764e9, os.sysconf("SC_CLK_TCK")
_BATCHES, _COLD = 6, 2  # micro-batches, and those at the start that do not count because the JVM is cold


class Fleet(NamedTuple):
    """The content of each micro-batch."""

    sensors: int
    rows: int  # rows of each sensor
    block: int = 0  # samples in each row's arrays; 0 for one sample per row, without arrays


class Cost(NamedTuple):
    """The cost of a million rows, in seconds."""

    wall_s: float
    jvm_s: float  # processor time
    python_s: float  # processor time


def timed(spark: SparkSession, folder: Path, fleet: Fleet) -> Cost:
    """Stream a lake; return the cost in the median micro-batch."""
    _write(folder, fleet)
    plan = StreamPlan(
        str(folder / "lake"), str(folder / "out"), SensorPlan(LiveBook(folder / "r.toml")), partitions=2, once=True
    )
    sources._LAKE_BYTES = sum(path.stat().st_size for path in (folder / "lake").rglob("0.parquet"))
    stream = query.run(spark, plan)
    marks, batch = [(time.monotonic(), *_used_s())], -1
    while stream.isActive:
        time.sleep(0.05)
        progress: Any = stream.lastProgress
        if progress is not None and progress["batchId"] > batch and progress["numInputRows"]:
            batch = progress["batchId"]
            marks.append((time.monotonic(), *_used_s()))
    query.wait(stream)
    costs = np.diff(np.array(marks), axis=0)[_COLD:] / (fleet.sensors * fleet.rows) * 1e6
    return Cost(*np.median(costs, axis=0).tolist())


@contextmanager
def in_frames() -> Iterator[None]:
    """Make Spark pass rows to Python as pandas frames, until the block ends."""

    def filtered(shape: StreamSchema, blocks: DataFrame, plan: SensorPlan) -> DataFrame:
        answers = blocks.groupBy("sensor").transformWithStateInPandas(
            _Frames(SensorStreamProcessor(plan, shape.channels)), ANSWER, "Append", "ProcessingTime"
        )
        return answers.mapInArrow(partial(to_output_batches, shape), shape.output_ddl)

    cloudpickle.register_pickle_by_value(sys.modules[__name__])  # type: ignore[no-untyped-call]  # workers cannot import it
    before, query._filtered = query._filtered, filtered
    try:
        yield
    finally:
        query._filtered = before


class _Frames(SensorProcessor):
    def handleInputRows(self, key: Any, rows: Iterator[Any], timerValues: Any) -> Iterator[Any]:  # noqa: N802
        import pandas as pd

        tuples = (row for frame in rows for row in frame.itertuples(index=False))
        answers = [row.asDict() for row in super().handleInputRows(key, tuples, timerValues)]
        columns = [column.split()[0] for column in ANSWER.split(", ")]
        yield pd.DataFrame(answers, columns=columns, dtype=object)  # pandas would turn a column of nulls into numbers


def _write(folder: Path, fleet: Fleet) -> None:
    (folder / "r.toml").write_text(RECIPE.to_toml(), encoding="utf-8")
    values = readings(fleet.rows * _BATCHES, CHANNELS, RATE_HZ)
    time_s = _BEGINS_S + np.arange(len(values)) / RATE_HZ
    for batch in range(_BATCHES):
        own = slice(batch * fleet.rows, (batch + 1) * fleet.rows)
        channels = {name: values[own, c] for c, name in enumerate(NAMES)}
        for sensor in range(fleet.sensors):
            place = folder / "lake" / f"sensor={sensor}" / f"{batch}.parquet"
            write_rows(place, time_s[own], channels, block=fleet.block)


def _used_s() -> tuple[float, float]:
    """Return the processor time that the JVM and Python's workers have used so far."""
    used = {"java": 0.0, "python": 0.0}
    for process in below(os.getpid()):
        fields = _stat(process.pid)
        used["java" if "SparkSubmit" in process.command else "python"] += sum(map(int, fields[11:13])) / _TICKS
    return used["java"], used["python"]


def _stat(pid: int) -> list[str]:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:  # the process has ended meanwhile
        return ["0"] * 20
