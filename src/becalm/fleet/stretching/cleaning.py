"""Clean long sensors: survey each sensor, cut it into stretches, clean these in parallel, and check the seams."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from becalm.fleet.job import Job, Sensor
from becalm.fleet.marks import CompletionMark
from becalm.fleet.outcome import Outcome
from becalm.fleet.sensor_cleaning import clean_whole, commit, refuse_on_error, report_lost_sensor
from becalm.fleet.spark_tasks import run_tasks
from becalm.fleet.stretching.joining import joined_outcome
from becalm.fleet.stretching.long_sensor import LongSensor, TaskStretch
from becalm.fleet.stretching.run import StretchEstimates, run_stretch
from becalm.fleet.stretching.seams import overlaps_agree, to_run_again
from becalm.fleet.stretching.survey import survey

if TYPE_CHECKING:
    from pyspark.sql import SparkSession


class Task(NamedTuple):
    """A task: clean one stretch of one long sensor."""

    sensor: int  # index in the list of long sensors
    stretch: TaskStretch


class LongSensorProgress:
    """The progress of one long sensor: the stretches that have run, and those to run next.

    Parameters
    ----------
    long : LongSensor
        The sensor.

    Attributes
    ----------
    failed : Outcome or None
        The refusal, if the sensor cannot be cleaned.
    whole : bool
        Whether cutting has failed, so that the sensor must be cleaned as a whole.
    """

    def __init__(self, long: LongSensor) -> None:
        self.long, self.whole = long, False
        self.failed: Outcome | None = None
        self._estimates: dict[int, StretchEstimates] = {}
        self._again, self._took_s = set[int](), long.took_s

    def add_result(self, result: StretchEstimates | Outcome) -> None:
        """Store the result of a stretch, or the refusal of the sensor."""
        if isinstance(result, Outcome):
            self.failed = result
        else:
            self._estimates[result.stretch.number] = result
            self._took_s += result.took_s

    def next_stretches(self) -> list[TaskStretch]:
        """Return the stretches to run next: first all, later those that started in a wrong state; [] at the end."""
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
        """Move the output into its folder, and return the outcome of the sensor.

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
        commit(
            long.job, long.sensor, Path(long.staged), CompletionMark(long.hashed, names, outcome, job=long.job.job_id)
        )
        return outcome

    def _was_run(self, stretch: TaskStretch) -> bool:
        """Return whether a stretch has already run from this state, so that another run would give the same result."""
        return self._estimates[stretch.number].stretch == stretch

    @property
    def _in_order(self) -> list[StretchEstimates]:
        return [self._estimates[number] for number in sorted(self._estimates)]


def clean_long(spark: SparkSession, job: Job, sensors: Sequence[Sensor]) -> list[Outcome]:
    """Clean sensors that may be long: cut those that are long, and clean their stretches in parallel.

    Parameters
    ----------
    spark : SparkSession
        The Spark to use.
    job : Job
        The job over the lake.
    sensors : sequence of Sensor
        The sensors of the lake that may be long.
    """
    surveys = run_tasks(spark, partial(survey, job), sensors, lost=report_lost_sensor)
    in_progress = [LongSensorProgress(one) for one in surveys if isinstance(one, LongSensor)]
    while tasks := [Task(k, stretch) for k, one in enumerate(in_progress) for stretch in one.next_stretches()]:
        longs = [one.long for one in in_progress]
        results = run_tasks(spark, partial(_run, longs), tasks, lost=partial(_report_lost, longs))
        for task, result in zip(tasks, results, strict=True):
            in_progress[task.sensor].add_result(result)
    uncut = [one.long.sensor for one in in_progress if one.whole]
    outcomes = [one for one in surveys if isinstance(one, Outcome)]
    outcomes += run_tasks(spark, partial(clean_whole, job), uncut, lost=report_lost_sensor)
    return outcomes + [refuse_on_error(one.long.sensor, one.finish) for one in in_progress if not one.whole]


def _run(longs: Sequence[LongSensor], task: Task) -> StretchEstimates | Outcome:
    long = longs[task.sensor]
    return refuse_on_error(long.sensor, lambda: run_stretch(long, task.stretch))


def _report_lost(longs: Sequence[LongSensor], task: Task, why: str) -> Outcome:
    return report_lost_sensor(longs[task.sensor].sensor, why)
