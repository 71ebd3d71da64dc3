"""Tasks on Spark: it says where and when they run, and runs them again where a machine is lost; no sample passes it."""

from __future__ import annotations

import gc
import pickle
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeVar

import pyarrow as pa

from becalm.errors import UsageError
from becalm.fleet.session import reason_of

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

Task = TypeVar("Task")
Told = TypeVar("Told")

_SCHEMA = "number long, told binary"
_TOGETHER_BYTES, _SHARES_A_CORE = 32 << 20, 4


def run_tasks(
    spark: SparkSession, work: Callable[[Task], Told], tasks: Sequence[Task], sizes: Sequence[int] = ()
) -> list[Told]:
    """Do some work for each of several tasks, the first ones first.

    Parameters
    ----------
    spark : SparkSession
        Where.
    work : callable
        Takes a task and tells what became of it; what it raises ends the job, so what a task may meet it has to tell.
    tasks : sequence
        Small things that can be pickled, as paths and numbers.
    sizes : sequence of int
        Of what each task reads, in bytes. Neighbours that are small are one task of Spark's, which costs some
        milliseconds; () for each by itself.

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

    cores = spark.sparkContext.defaultParallelism
    shares = _shares(sizes, cores) if sizes else [range(number, number + 1) for number in range(len(tasks))]
    planned = spark.sparkContext.broadcast(_packed((work, list(tasks), shares)))

    def run(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        work, tasks, shares = _unpacked(planned.value)
        for batch in batches:
            for number in chain.from_iterable(shares[share] for share in batch.column(0).to_pylist()):
                yield _row(number, work(tasks[number]))
        _settle(planned.value)

    try:
        found: Any = spark.range(0, len(shares), 1, len(shares)).mapInArrow(run, _SCHEMA)
        told = {row.number: pickle.loads(row.told) for row in found.collect()}
    except (Py4JError, PySparkException) as cause:
        raise UsageError(
            f"Spark gave the job up ({reason_of(cause)}). What was finished stays as it is; repeat, and it goes on."
        ) from cause
    finally:
        with suppress(Py4JError):  # where Spark itself is gone
            planned.destroy()
    return [told[number] for number in range(len(tasks))]


def _shares(sizes: Sequence[int], cores: int) -> list[range]:
    """Return which tasks run together: neighbours up to some bytes, and ever fewer, so that all cores end at once."""
    shares, first, held, left = list[range](), 0, 0, sum(sizes)
    for number, size in enumerate(sizes):
        if number > first and held + size > min(_TOGETHER_BYTES, left / (_SHARES_A_CORE * cores)):
            shares.append(range(first, number))
            first, held, left = number, 0, left - held
        held += size
    return [*shares, range(first, len(sizes))]


@lru_cache(maxsize=2)
def _settle(planned: bytes) -> None:
    """Keep what a worker has loaded for its first task from being looked through for garbage after each, as Spark does.

    With all of becalm's libraries that takes 75 ms, more than the work on many a sensor.
    """
    gc.collect()
    gc.freeze()


def _packed(planned: object) -> bytes:
    from pyspark import cloudpickle

    packed: bytes = cloudpickle.dumps(planned)  # type: ignore[no-untyped-call]
    return packed


@lru_cache(maxsize=2)
def _unpacked(planned: bytes) -> tuple[Callable[[Any], Any], list[Any], list[range]]:
    """Unpack what a worker is to do once, and not for each task."""
    work, tasks, shares = pickle.loads(planned)
    return work, tasks, shares


def _row(number: int, told: object) -> pa.RecordBatch:
    columns = [pa.array([number], pa.int64()), pa.array([pickle.dumps(told)], pa.binary())]
    return pa.RecordBatch.from_arrays(columns, names=["number", "told"])
