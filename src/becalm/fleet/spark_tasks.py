"""Tasks on Spark: it says where and when they run, and runs them again where a machine is lost; no sample passes it."""

from __future__ import annotations

import gc
import os
import pickle
import re
import signal
import threading
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
_DIED = re.compile("worker exited unexpectedly|ExecutorLostFailure")
_MOST_DEATHS = 16  # of tasks: where more die, it is not the tasks
_ALL_DIED = (
    "Each process that worked on it died. It may need more memory than there is, or break the library that reads its"
    " files; try it alone: becalm clean."
)


def run_tasks(
    spark: SparkSession,
    work: Callable[[Task], Told],
    tasks: Sequence[Task],
    sizes: Sequence[int] = (),
    lost: Callable[[Task, str], Told] | None = None,
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
    lost : callable, optional
        Tells, for a task whose workers all died and the reason, what became of it: halves of a job that Spark gave up
        are run by themselves until it is found. Where None, such a task ends the job.

    Returns
    -------
    list
        What was told, in the order of the tasks.

    Raises
    ------
    UsageError
        If Spark gives the job up: workers died again and again, or there are none.
    """
    from py4j.protocol import Py4JError
    from pyspark.errors import PySparkException

    told, left, deaths = dict[int, Told](), [range(len(tasks))], 0
    while left:
        span = left.pop()
        own = slice(span.start, span.stop)
        try:
            told |= zip(span, _run(spark, work, tasks[own], sizes[own]), strict=True)
        except (Py4JError, PySparkException, ConnectionError) as cause:  # the last where Spark itself is gone
            if lost is None or not _DIED.search(str(cause)) or deaths == _MOST_DEATHS:
                many = f" Workers died of more than {deaths} tasks, which is hardly their fault." if deaths else ""
                raise UsageError(
                    f"Spark gave the job up ({reason_of(cause)}).{many} What was finished stays as it is; repeat, and"
                    " it goes on."
                ) from cause
            half = (span.start + span.stop) // 2
            if len(span) > 1:
                left += [range(half, span.stop), range(span.start, half)]
            else:
                deaths += 1
                told[span.start] = lost(tasks[span.start], _ALL_DIED)
    return [told[number] for number in range(len(tasks))]


def _run(spark: SparkSession, work: Callable[[Task], Told], tasks: Sequence[Task], sizes: Sequence[int]) -> list[Told]:
    """Do the work of one stage; what Spark raises is raised."""
    from py4j.protocol import Py4JError

    if not tasks:
        return []
    cores = spark.sparkContext.defaultParallelism
    shares = _shares(sizes, cores) if sizes else [range(number, number + 1) for number in range(len(tasks))]
    packed = [_packed([tasks[number] for number in share]) for share in shares]  # of which a worker opens its own
    planned = spark.sparkContext.broadcast(_packed((work, shares, packed)))

    def run(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        work, shares, packed = _unpacked(planned.value)
        for share in chain.from_iterable(batch.column(0).to_pylist() for batch in batches):
            for number, task in zip(shares[share], pickle.loads(packed[share]), strict=True):
                yield _row(number, work(task))
        _settle(planned.value)

    try:
        found: Any = spark.range(0, len(shares), 1, len(shares)).mapInArrow(run, _SCHEMA)
        told = {row.number: pickle.loads(row.told) for row in found.collect()}
    finally:
        with suppress(Py4JError, ConnectionError):  # where Spark itself is gone
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
    """Make a worker ready for more tasks than its first one.

    What it has loaded is not looked through for garbage after each, as Spark does: with all of becalm's libraries that
    takes longer than the work on many a sensor. And where its JVM is gone it dies of its first word to it, as programs
    do whose reader is gone; Python's own way is a traceback.
    """
    gc.collect()
    gc.freeze()
    if os.name == "posix" and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)


def _packed(planned: object) -> bytes:
    from pyspark import cloudpickle

    packed: bytes = cloudpickle.dumps(planned)  # type: ignore[no-untyped-call]
    return packed


@lru_cache(maxsize=2)
def _unpacked(planned: bytes) -> tuple[Callable[[Any], Any], list[range], list[bytes]]:
    """Unpack what workers are to do once, and not for each task."""
    work, shares, packed = pickle.loads(planned)
    return work, shares, packed


def _row(number: int, told: object) -> pa.RecordBatch:
    columns = [pa.array([number], pa.int64()), pa.array([pickle.dumps(told)], pa.binary())]
    return pa.RecordBatch.from_arrays(columns, names=["number", "told"])
