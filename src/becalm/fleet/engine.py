"""Tasks on Spark: it says where and when they run, and runs them again where a machine is lost; no sample passes it."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

import pyarrow as pa

from becalm.errors import UsageError
from becalm.fleet.session import reason_of

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

    Raises
    ------
    UsageError
        If Spark gives the job up: workers died again and again, or there are none.
    """
    if not tasks:
        return []
    from py4j.protocol import Py4JError
    from pyspark.errors import PySparkException

    count, planned = len(tasks), spark.sparkContext.broadcast(_packed((work, list(tasks))))

    def run(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        work, tasks = _unpacked(planned.value)
        for batch in batches:
            for number in batch.column(0).to_pylist():
                yield _row(number, work(tasks[number]))

    try:
        found: Any = spark.range(0, count, 1, count).mapInArrow(run, _SCHEMA)
        told = {row.number: pickle.loads(row.told) for row in found.collect()}
    except (Py4JError, PySparkException) as cause:
        raise UsageError(
            f"Spark gave the job up ({reason_of(cause)}). What was finished stays as it is; repeat, and it goes on."
        ) from cause
    finally:
        with suppress(Py4JError):  # where Spark itself is gone
            planned.destroy()
    return [told[number] for number in range(count)]


def _packed(planned: object) -> bytes:
    from pyspark import cloudpickle

    packed: bytes = cloudpickle.dumps(planned)  # type: ignore[no-untyped-call]
    return packed


@lru_cache(maxsize=2)
def _unpacked(planned: bytes) -> tuple[Callable[[Any], Any], list[Any]]:
    """Unpack what a worker is to do once, and not for each task."""
    work, tasks = pickle.loads(planned)
    return work, tasks


def _row(number: int, told: object) -> pa.RecordBatch:
    columns = [pa.array([number], pa.int64()), pa.array([pickle.dumps(told)], pa.binary())]
    return pa.RecordBatch.from_arrays(columns, names=["number", "told"])
