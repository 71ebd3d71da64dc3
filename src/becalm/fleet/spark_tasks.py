"""Run tasks on Spark. Spark schedules tasks and repeats those of a lost machine; no sample passes through Spark."""

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
# Tasks that share a Spark task read at most `_SHARED_BYTES`, and at most 1 / (`_SHARES_A_CORE` * cores) of the bytes
# of all tasks that have no Spark task yet.
_SHARED_BYTES, _SHARES_A_CORE = 32 << 20, 4
_DIED = re.compile("worker exited unexpectedly|ExecutorLostFailure")
_MOST_DEATHS = 16  # if workers die on more tasks than this, the tasks are hardly the cause, and the job ends
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
    """Run a function on each of several tasks; Spark starts the tasks in their order.

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
        Bytes that each task reads. Neighbouring small tasks share one Spark task, because each Spark task costs some
        milliseconds. With () each task has a Spark task of its own.
    lost : callable, optional
        Takes a task and a reason, and returns the result of a task on which every worker died. To find this task, a
        list of tasks that Spark gave up is halved, and each half runs by itself. If None, such a task ends the job.

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
    """Run tasks in one Spark stage; exceptions of Spark are not caught."""
    from py4j.protocol import Py4JError

    if not tasks:
        return []
    cores = spark.sparkContext.defaultParallelism
    shares = _group_tasks(sizes, cores) if sizes else [range(number, number + 1) for number in range(len(tasks))]
    packed = [_pack([tasks[number] for number in share]) for share in shares]  # a worker unpickles its own shares
    planned = spark.sparkContext.broadcast(_pack((work, shares, packed)))

    def run(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        work, shares, packed = _unpack(planned.value)
        for share in chain.from_iterable(batch.column(0).to_pylist() for batch in batches):
            for number, task in zip(shares[share], pickle.loads(packed[share]), strict=True):
                yield _result_batch(number, work(task))
        _prepare_worker(planned.value)

    try:
        frame: Any = spark.range(0, len(shares), 1, len(shares)).mapInArrow(run, _SCHEMA)
        results = {row.number: pickle.loads(row.result) for row in frame.collect()}
    finally:
        with suppress(Py4JError, ConnectionError):  # if Spark itself is gone
            planned.destroy()
    return [results[number] for number in range(len(tasks))]


def _group_tasks(sizes: Sequence[int], cores: int) -> list[range]:
    """Group neighbouring tasks of few bytes; make later groups smaller, so that all cores end about together."""
    shares, first, held, left = list[range](), 0, 0, sum(sizes)
    for number, size in enumerate(sizes):
        if number > first and held + size > min(_SHARED_BYTES, left / (_SHARES_A_CORE * cores)):
            shares.append(range(first, number))
            first, held, left = number, 0, left - held
        held += size
    return [*shares, range(first, len(sizes))]


@lru_cache(maxsize=2)
def _prepare_worker(planned: bytes) -> None:
    """Prepare a worker process for further tasks.

    Spark collects garbage after each task. With becalm's libraries loaded, a collection takes longer than the work on
    many sensors. Therefore the loaded objects are frozen: later collections skip them. If the JVM has ended, SIGPIPE
    ends the worker at its next write, without a message; by default, Python would print a traceback.
    """
    gc.collect()
    gc.freeze()
    if os.name == "posix" and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)


def _pack(planned: object) -> bytes:
    from pyspark import cloudpickle

    packed: bytes = cloudpickle.dumps(planned)  # type: ignore[no-untyped-call]
    return packed


@lru_cache(maxsize=2)
def _unpack(planned: bytes) -> tuple[Callable[[Any], Any], list[range], list[bytes]]:
    """Unpickle the planned tasks once for each worker, and not for each task."""
    work, shares, packed = pickle.loads(planned)
    return work, shares, packed


def _result_batch(number: int, result: object) -> pa.RecordBatch:
    columns = [pa.array([number], pa.int64()), pa.array([pickle.dumps(result)], pa.binary())]
    return pa.RecordBatch.from_arrays(columns, names=["number", "result"])
