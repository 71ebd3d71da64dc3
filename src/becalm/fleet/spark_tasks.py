"""Run tasks on Spark. Spark schedules them and repeats them if a machine is lost; no sample passes through it."""

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
Result = TypeVar("Result")

_SCHEMA = "number long, result binary"
# The tasks that share a Spark task read at most this many bytes, and at most 1 / (this * cores) of all that are left.
_TOGETHER_BYTES, _SHARES_A_CORE = 32 << 20, 4
_DIED = re.compile("worker exited unexpectedly|ExecutorLostFailure")
_MOST_DEATHS = 16  # tasks on which all workers may die; if there are more, the tasks are hardly the cause
_ALL_DIED = (
    "Every process that worked on it died. It may need more memory than there is, or crash the library that reads its"
    " files; clean this sensor by itself with becalm clean."
)


def run_tasks(
    spark: SparkSession,
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    sizes: Sequence[int] = (),
    lost: Callable[[Task, str], Result] | None = None,
) -> list[Result]:
    """Run a function on each of several tasks; Spark starts them in their order.

    Parameters
    ----------
    spark : SparkSession
        The Spark to use.
    work : callable
        Takes a task and returns its result. An exception ends the whole job, so `work` must return expected failures
        as results.
    tasks : sequence
        Small objects that can be pickled, such as paths and numbers.
    sizes : sequence of int
        Bytes that each task reads. Small neighbours share one Spark task, because each Spark task costs some
        milliseconds. With () each task is a Spark task of its own.
    lost : callable, optional
        Takes a task whose workers all died, and the reason, and returns its result. To find that task, a job that
        Spark gave up is halved, and each half runs by itself. If None, such a task ends the job.

    Returns
    -------
    list
        The results, in the order of the tasks.

    Raises
    ------
    UsageError
        If Spark gives the job up because workers died repeatedly or there are no workers.
    """
    from py4j.protocol import Py4JError
    from pyspark.errors import PySparkException

    results, left, deaths = dict[int, Result](), [range(len(tasks))], 0
    while left:
        span = left.pop()
        own = slice(span.start, span.stop)
        try:
            results |= zip(span, _run(spark, work, tasks[own], sizes[own]), strict=True)
        except (Py4JError, PySparkException, ConnectionError) as cause:  # ConnectionError if Spark itself is gone
            if lost is None or not _DIED.search(str(cause)) or deaths == _MOST_DEATHS:
                many = f" Workers died on more than {deaths} tasks: the tasks are hardly the cause." if deaths else ""
                raise UsageError(
                    f"Spark gave the job up ({reason_of(cause)}).{many} Finished sensors are kept; run the same command"
                    " again to continue."
                ) from cause
            half = (span.start + span.stop) // 2
            if len(span) > 1:
                left += [range(half, span.stop), range(span.start, half)]
            else:
                deaths += 1
                results[span.start] = lost(tasks[span.start], _ALL_DIED)
    return [results[number] for number in range(len(tasks))]


def _run(
    spark: SparkSession, work: Callable[[Task], Result], tasks: Sequence[Task], sizes: Sequence[int]
) -> list[Result]:
    """Run one Spark stage; exceptions of Spark are passed on."""
    from py4j.protocol import Py4JError

    if not tasks:
        return []
    cores = spark.sparkContext.defaultParallelism
    shares = _shares(sizes, cores) if sizes else [range(number, number + 1) for number in range(len(tasks))]
    packed = [_packed([tasks[number] for number in share]) for share in shares]  # a worker unpickles only its own
    planned = spark.sparkContext.broadcast(_packed((work, shares, packed)))

    def run(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        work, shares, packed = _unpacked(planned.value)
        for share in chain.from_iterable(batch.column(0).to_pylist() for batch in batches):
            for number, task in zip(shares[share], pickle.loads(packed[share]), strict=True):
                yield _row(number, work(task))
        _settle(planned.value)

    try:
        frame: Any = spark.range(0, len(shares), 1, len(shares)).mapInArrow(run, _SCHEMA)
        results = {row.number: pickle.loads(row.result) for row in frame.collect()}
    finally:
        with suppress(Py4JError, ConnectionError):  # if Spark itself is gone
            planned.destroy()
    return [results[number] for number in range(len(tasks))]


def _shares(sizes: Sequence[int], cores: int) -> list[range]:
    """Group neighbouring tasks up to a number of bytes; later groups are smaller, so that all cores end together."""
    shares, first, held, left = list[range](), 0, 0, sum(sizes)
    for number, size in enumerate(sizes):
        if number > first and held + size > min(_TOGETHER_BYTES, left / (_SHARES_A_CORE * cores)):
            shares.append(range(first, number))
            first, held, left = number, 0, left - held
        held += size
    return [*shares, range(first, len(sizes))]


@lru_cache(maxsize=2)
def _settle(planned: bytes) -> None:
    """Prepare a worker process for further tasks.

    Spark collects garbage after each task. With becalm's libraries loaded, that takes longer than the work on many
    sensors, so the loaded objects are frozen: later collections skip them. If the JVM is gone, the worker ends quietly
    by SIGPIPE at its next write; by default, Python would print a traceback.
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
    """Unpickle a worker's plan once, and not for each task."""
    work, shares, packed = pickle.loads(planned)
    return work, shares, packed


def _row(number: int, result: object) -> pa.RecordBatch:
    columns = [pa.array([number], pa.int64()), pa.array([pickle.dumps(result)], pa.binary())]
    return pa.RecordBatch.from_arrays(columns, names=["number", "result"])
