"""A lake through its recipes: what is to be done is planned here, done by workers, and told in a report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from shlex import quote
from time import monotonic
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from becalm.errors import UsageError
from becalm.files.text_file import make_folder, write_text
from becalm.fleet.class_outliers import marked
from becalm.fleet.grouped.cleaning import clean_grouped
from becalm.fleet.job import STRETCH_ROWS, Job, Sensor
from becalm.fleet.lake import FILE, FOLDER, MultiSensorLake, SensorPlace, told_apart
from becalm.fleet.marks import CompletionMark
from becalm.fleet.outcome import Outcome, refused
from becalm.fleet.output_lock import alone_at
from becalm.fleet.recipes import RecipeBook
from becalm.fleet.sensor_cleaning import all_died, clean_whole
from becalm.fleet.spark_tasks import run_tasks
from becalm.fleet.stretching.cleaning import clean_long
from becalm.fleet.sweeping import swept
from becalm.report.fleet_order import summary
from becalm.report.fleet_page import FleetFacts, fleet_page
from becalm.report.fleet_rows import FleetRow

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

ABOUT = "_becalm"
"""Folder in an output that tells of the job, and holds no samples."""

_LEAST_BYTES = 1
"""Of a row in a Parquet file: what is smaller cannot be long."""


class BatchOptions(NamedTuple):
    """What may be asked of a job beside its recipes."""

    by: str = FOLDER
    causal: bool | None = None
    stretch_rows: int = STRETCH_ROWS


AS_RECIPES_SAY = BatchOptions()


@dataclass(frozen=True)
class Fleet:
    """What became of a lake.

    Attributes
    ----------
    outcomes : tuple of Outcome
        One a sensor, by name.
    report : Path
        The page that tells of them, worst first.
    unused : tuple of str
        Names of recipes that no sensor has.
    """

    outcomes: tuple[Outcome, ...]
    report: Path
    unused: tuple[str, ...] = ()

    @property
    def rows(self) -> list[FleetRow]:
        """What became of each channel of each sensor."""
        return [row for outcome in self.outcomes for row in outcome.channels]

    @property
    def summary(self) -> str:
        """What became of all of it, in a sentence."""
        return summary(self.rows)


def clean(
    spark: SparkSession, lake: Path, output: Path, book: RecipeBook, asked: BatchOptions = AS_RECIPES_SAY
) -> Fleet:
    """Clean every sensor of a lake; what was finished before, and has not changed, is left as it is.

    Parameters
    ----------
    spark : SparkSession
        Where; all its workers must have becalm, and see the lake and the output under these paths.
    lake : Path
        A folder of Parquet files, as `sensor=17/date=2026-01-02/part-0.parquet`. It is only read.
    output : Path
        A folder for as many files of the same names; those of a sensor appear when all of it is done. Of a sensor that
        shares its files with others it is one, as `sensor=17/part-0.parquet`.
    book : RecipeBook
        What to do with each sensor.
    asked : BatchOptions
        What tells a sensor, and whether estimates know only the past.

    Raises
    ------
    InputError
        If the lake holds no sensor, or cannot be read.
    UsageError
        If the output is in the lake, or its folders do not tell sensors apart.
    """
    began, started = datetime.now(UTC), monotonic()
    lake, output = lake.resolve(), output.resolve()
    refuse_inside(lake, output)
    told = told_apart(lake, asked.by)
    make_folder(output / ABOUT)
    by = FILE if asked.by == FILE else FOLDER  # a folder in the output, whatever tells sensors apart in the lake
    tune = "tune FILE -o R.toml" if isinstance(told, MultiSensorLake) else f"fleet tune {quote(str(lake))} -o DIR"
    job = Job(str(lake), str(output), book.by_hash, by, asked.causal, asked.stretch_rows, f"becalm {tune}")
    with alone_at(output, output / ABOUT / "lock"):
        found = sorted(_cleaned(spark, job, told, book), key=lambda outcome: outcome.sensor)
        outcomes = marked([_with_older(job, outcome) for outcome in found])
        swept(output)
        rows = sum(outcome.rows for outcome in outcomes)
        facts = FleetFacts(lake.name, output.name, began.isoformat(), monotonic() - started, rows, book.names)
        unused = book.unused(outcome.sensor for outcome in outcomes)
        return _told(Fleet(tuple(outcomes), output / ABOUT / "report.html", unused), facts)


def _cleaned(
    spark: SparkSession, job: Job, told: Sequence[SensorPlace] | MultiSensorLake, book: RecipeBook
) -> list[Outcome]:
    if isinstance(told, MultiSensorLake):
        return clean_grouped(spark, job, told, book)
    hashes = {place.name: book.hash_for(place.name) for place in told}
    sensors = [Sensor(place.name, place.bytes, one, place.files) for place in told if (one := hashes[place.name])]
    sensors.sort(key=lambda sensor: -sensor.bytes)  # the longest first, so that none is waited for in the end
    may_be_long = 2 * job.stretch_rows * _LEAST_BYTES if job.by == FOLDER else np.inf
    long = [sensor for sensor in sensors if sensor.bytes > may_be_long]
    usual = sensors[len(long) :]
    with ThreadPoolExecutor(1) as beside:  # what one leaves of the cluster the other takes
        of_long = beside.submit(clean_long, spark, job, long)
        sizes = [sensor.bytes for sensor in usual]
        outcomes = run_tasks(spark, partial(clean_whole, job), usual, sizes, all_died) + of_long.result()
    return outcomes + [refused(name, book.why_not(name)) for name, one in hashes.items() if one is None]


def _with_older(job: Job, outcome: Outcome) -> Outcome:
    """Say of a sensor that was refused where an output of an earlier job still is."""
    sensor = Sensor(outcome.sensor, 0, "")
    mark = CompletionMark.of(job.mark_of(sensor)) if outcome.state == "refused" else None
    if mark is None or not mark.files:
        return outcome
    older = f" An older output is still in {job.output_folder(sensor)}."
    return refused(outcome.sensor, outcome.reason + older, outcome.took_s)


def refuse_inside(lake: Path, output: Path) -> None:
    """Refuse an output that is the lake, or in it, or around it.

    Raises
    ------
    UsageError
        If it is.
    """
    if lake == output or lake in output.parents or output in lake.parents:
        raise UsageError(f"{output} is not apart from {lake}; raw data stay as they are. Name another with -o.")


def _told(fleet: Fleet, facts: FleetFacts) -> Fleet:
    lines = [json.dumps(outcome.as_dict()) + "\n" for outcome in fleet.outcomes]
    write_text(fleet.report.with_name("outcomes.jsonl"), "".join(lines))
    write_text(fleet.report, fleet_page(fleet.rows, facts))
    return fleet
