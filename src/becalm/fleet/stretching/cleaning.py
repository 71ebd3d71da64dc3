"""Clean long sensors: survey each, cut it into stretches, clean these in parallel, and check the seams."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from becalm.fleet.job import Job, Sensor
from becalm.fleet.marks import CompletionMark
from becalm.fleet.outcome import Outcome
from becalm.fleet.sensor_cleaning import all_died, clean_whole, commit, refuse_on_error
from becalm.fleet.spark_tasks import run_tasks
from becalm.fleet.stretching.joining import joined_outcome
from becalm.fleet.stretching.long_sensor import LongSensor, TaskStretch
from becalm.fleet.stretching.run import StretchEstimates, run_stretch
from becalm.fleet.stretching.seams import overlaps_agree, to_run_again
from becalm.fleet.stretching.survey import survey

if TYPE_CHECKING:
    from pyspark.sql import SparkSession


class Task(NamedTuple):
    """A stretch of one of several long sensors."""

    sensor: int  # index in the list of long sensors
    stretch: TaskStretch


class LongSensorProgress:
    """The progress of one long sensor: which stretches have run, and which run next.

    Parameters
    ----------
    long : LongSensor
        The sensor.

    Attributes
    ----------
    failed : Outcome or None
        The refusal, if the sensor cannot be cleaned.
    whole : bool
        Whether the sensor cannot be cut and must be cleaned as a whole.
    """

    def __init__(self, long: LongSensor) -> None:
        self.long, self.whole = long, False
        self.failed: Outcome | None = None
        self._estimates: dict[int, StretchEstimates] = {}
        self._again, self._took_s = set[int](), long.took_s

    def hear(self, result: StretchEstimates | Outcome) -> None:
        """Store the result of a stretch."""
        if isinstance(result, Outcome):
            self.failed = result
        else:
            self._estimates[result.stretch.number] = result
            self._took_s += result.took_s

    def next(self) -> list[TaskStretch]:
        """Return the stretches to run next: first all, then those that began in a state other than the correct one."""
        if self.failed is not None or self.whole:
            return []
        if not self._estimates:
            return [TaskStretch(number, *span) for number, span in enumerate(pairwise(self.long.cuts))]
        if not self.long.causal:
            self.whole = not overlaps_agree(self._in_order)
            return []
        again = to_run_again(self._in_order)
        self.whole = again is None or any(map(self._was_run, again))
        self._again.update(stretch.number for stretch in again or ())
        return [] if self.whole else again or []

    def finish(self) -> Outcome:
        """Move the output into place, and return the outcome of the sensor.

        Raises
        ------
        OutputError
            If the output cannot be moved.
        """
        if self.failed is not None:
            return self.failed
        long, stretches = self.long, self._in_order
        outcome = joined_outcome(long, stretches, len(self._again), self._took_s)
        names = tuple(piece.name for one in stretches for piece in one.pieces)
        commit(long.job, long.sensor, Path(long.staged), CompletionMark(long.hashed, names, outcome, job=long.job.own))
        return outcome

    def _was_run(self, stretch: TaskStretch) -> bool:
        """Return whether a stretch already ran from exactly this state, so that another run would change nothing."""
        return self._estimates[stretch.number].stretch == stretch

    @property
    def _in_order(self) -> list[StretchEstimates]:
        return [self._estimates[number] for number in sorted(self._estimates)]


def clean_long(spark: SparkSession, job: Job, sensors: Sequence[Sensor]) -> list[Outcome]:
    """Clean sensors that may be long; cut those that are, and clean their stretches in parallel.

    Parameters
    ----------
    spark : SparkSession
        The Spark to use.
    job : Job
        The job over the lake.
    sensors : sequence of Sensor
        The sensors of the lake that may be long.
    """
    surveys = run_tasks(spark, partial(survey, job), sensors, lost=all_died)
    courses = [LongSensorProgress(one) for one in surveys if isinstance(one, LongSensor)]
    while tasks := [Task(place, stretch) for place, course in enumerate(courses) for stretch in course.next()]:
        longs = [course.long for course in courses]
        results = run_tasks(spark, partial(_run, longs), tasks, lost=partial(_died, longs))
        for task, result in zip(tasks, results, strict=True):
            courses[task.sensor].hear(result)
    uncut = [course.long.sensor for course in courses if course.whole]
    outcomes = [one for one in surveys if isinstance(one, Outcome)]
    outcomes += run_tasks(spark, partial(clean_whole, job), uncut, lost=all_died)
    return outcomes + [refuse_on_error(course.long.sensor, course.finish) for course in courses if not course.whole]


def _run(longs: Sequence[LongSensor], task: Task) -> StretchEstimates | Outcome:
    long = longs[task.sensor]
    return refuse_on_error(long.sensor, lambda: run_stretch(long, task.stretch))


def _died(longs: Sequence[LongSensor], task: Task, why: str) -> Outcome:
    return all_died(longs[task.sensor].sensor, why)
