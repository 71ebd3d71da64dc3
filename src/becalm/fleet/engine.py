"""Tasks on Spark: it says where and when they run, and runs them again where a machine is lost; no sample passes it."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import pyarrow as pa

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

Task = TypeVar("Task")
Told = TypeVar("Told")

_SCHEMA = "number long, told binary"


def run_tasks(spark: SparkSession, work: Callable[[Task], Told], tasks: Sequence[Task]) -> list[Told]:
    """Do some work for each of several tasks, each in a partition of its own, the first ones first.

    Parameters
    ----------
    spark : SparkSession
        Where.
    work : callable
        Takes a task and tells what became of it; what it raises ends the job, so what a task may meet it has to tell.
    tasks : sequence
        Small things that can be pickled, as paths and numbers.

    Returns
    -------
    list
        What was told, in the order of the tasks.
    """
    if not tasks:
        return []
    kept = list(tasks)

    def run(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        for batch in batches:
            for number in batch.column(0).to_pylist():
                yield _row(number, work(kept[number]))

    count = len(kept)
    found: Any = spark.range(0, count, 1, count).mapInArrow(run, _SCHEMA)
    told = {row.number: pickle.loads(row.told) for row in found.collect()}
    return [told[number] for number in range(count)]


def _row(number: int, told: object) -> pa.RecordBatch:
    columns = [pa.array([number], pa.int64()), pa.array([pickle.dumps(told)], pa.binary())]
    return pa.RecordBatch.from_arrays(columns, names=["number", "told"])
