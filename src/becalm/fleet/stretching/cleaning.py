"""Long sensors through their recipes: looked over, cut, cleaned side by side, and certified."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from becalm.fleet.job import Job, Sensor
from becalm.fleet.marks import CompletionMark
from becalm.fleet.outcome import Outcome
from becalm.fleet.sensor_cleaning import all_died, clean_whole, commit, told_by
from becalm.fleet.spark_tasks import run_tasks
from becalm.fleet.stretching.joining import joined_outcome
from becalm.fleet.stretching.long import Long, TaskStretch
from becalm.fleet.stretching.run import StretchEstimates, run_stretch
from becalm.fleet.stretching.seams import overlaps_agree, to_run_again
from becalm.fleet.stretching.survey import survey

if TYPE_CHECKING:
    from pyspark.sql import SparkSession


class Task(NamedTuple):
    """A stretch of one of several long sensors."""

    sensor: int  # its place among them
    stretch: TaskStretch


class Course:
    """How far a long sensor has come.

    Parameters
    ----------
    long : Long
        The sensor.

    Attributes
    ----------
    failed : Outcome or None
        Why it cannot be cleaned.
    whole : bool
        Whether it cannot be cut, and has to be cleaned as a whole.
    """

    def __init__(self, long: Long) -> None:
        self.long, self.whole = long, False
        self.failed: Outcome | None = None
        self._told: dict[int, StretchEstimates] = {}
        self._again, self._took_s = set[int](), long.took_s

    def hear(self, told: StretchEstimates | Outcome) -> None:
        """Take what became of a stretch."""
        if isinstance(told, Outcome):
            self.failed = told
        else:
            self._told[told.stretch.number] = told
            self._took_s += told.took_s

    def next(self) -> list[TaskStretch]:
        """Return what is to be run now: all stretches; then those that do not begin where the one before ended."""
        if self.failed is not None or self.whole:
            return []
        if not self._told:
            return [TaskStretch(number, *span) for number, span in enumerate(pairwise(self.long.cuts))]
        if not self.long.causal:
            self.whole = not overlaps_agree(self._in_order)
            return []
        again = to_run_again(self._in_order)
        self.whole = again is None or any(map(self._was_run, again))
        self._again.update(stretch.number for stretch in again or ())
        return [] if self.whole else again or []

    def finish(self) -> Outcome:
        """Let the output appear, and say what became of the sensor.

        Raises
        ------
        OutputError
            If the output cannot appear.
        """
        if self.failed is not None:
            return self.failed
        long, told = self.long, self._in_order
        outcome = joined_outcome(long, told, len(self._again), self._took_s)
        names = tuple(piece.name for one in told for piece in one.pieces)
        commit(long.job, long.sensor, Path(long.staged), CompletionMark(long.hashed, names, outcome, job=long.job.own))
        return outcome

    def _was_run(self, stretch: TaskStretch) -> bool:
        """Whether a stretch was run from where it is to be run again: then it would be run for ever."""
        return self._told[stretch.number].stretch == stretch

    @property
    def _in_order(self) -> list[StretchEstimates]:
        return [self._told[number] for number in sorted(self._told)]


def clean_long(spark: SparkSession, job: Job, sensors: Sequence[Sensor]) -> list[Outcome]:
    """Clean sensors that may be long, each in several tasks at once.

    Parameters
    ----------
    spark : SparkSession
        Where.
    job : Job
        What is to be done.
    sensors : sequence of Sensor
        Of the lake.
    """
    looked = run_tasks(spark, partial(survey, job), sensors, lost=all_died)
    courses = [Course(one) for one in looked if isinstance(one, Long)]
    while tasks := [Task(place, stretch) for place, course in enumerate(courses) for stretch in course.next()]:
        longs = [course.long for course in courses]
        found = run_tasks(spark, partial(_run, longs), tasks, lost=partial(_died, longs))
        for task, told in zip(tasks, found, strict=True):
            courses[task.sensor].hear(told)
    uncut = [course.long.sensor for course in courses if course.whole]
    outcomes = [one for one in looked if isinstance(one, Outcome)]
    outcomes += run_tasks(spark, partial(clean_whole, job), uncut, lost=all_died)
    return outcomes + [told_by(course.long.sensor, course.finish) for course in courses if not course.whole]


def _run(longs: Sequence[Long], task: Task) -> StretchEstimates | Outcome:
    long = longs[task.sensor]
    return told_by(long.sensor, lambda: run_stretch(long, task.stretch))


def _died(longs: Sequence[Long], task: Task, why: str) -> Outcome:
    return all_died(longs[task.sensor].sensor, why)
