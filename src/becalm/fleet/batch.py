"""Clean a lake with recipes: plan the job, run its tasks on Spark, and write a report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from becalm.errors import UsageError
from becalm.files.atomic_file import make_folder, write_text
from becalm.fleet.class_outliers import mark_outliers
from becalm.fleet.grouped.cleaning import clean_grouped
from becalm.fleet.job import STRETCH_ROWS, Job, Sensor
from becalm.fleet.lake import FILE, FOLDER, MultiSensorLake, SensorPlace, find_sensor_layout
from becalm.fleet.leftovers import remove_leftovers
from becalm.fleet.marks import CompletionMark
from becalm.fleet.outcome import Outcome, refused
from becalm.fleet.output_lock import lock_output
from becalm.fleet.recipes import RecipeBook
from becalm.fleet.sensor_cleaning import clean_whole, report_lost_sensor
from becalm.fleet.spark_tasks import run_tasks
from becalm.fleet.stretching.cleaning import clean_long
from becalm.installation import typed
from becalm.report.fleet.fleet_order import summary
from becalm.report.fleet.fleet_page import FleetFacts, fleet_page
from becalm.report.fleet.fleet_rows import FleetRow

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

ABOUT = "_becalm"
"""Folder in the output for files about the job: report, outcomes and lock. It has no samples."""

_LEAST_BYTES = 1
"""Assumed smallest size of a row in a Parquet file, in bytes. By this size, small sensors cannot be long."""


class BatchOptions(NamedTuple):
    """Options of a job besides its recipes."""

    by: str = FOLDER  # what identifies a sensor: "folder", "file", or a column; see `find_sensor_layout`
    causal: bool | None = None  # whether estimates use only the past; None for the mode of each recipe
    stretch_rows: int = STRETCH_ROWS  # least number of rows of a stretch


DEFAULT_OPTIONS = BatchOptions()


@dataclass(frozen=True)
class Fleet:
    """The result of a job over a lake.

    Attributes
    ----------
    outcomes : tuple of Outcome
        One outcome for each sensor, sorted by name.
    report : Path
        The report page, which lists the sensors worst first.
    unused : tuple of str
        Names of recipes that no sensor uses.
    """

    outcomes: tuple[Outcome, ...]
    report: Path
    unused: tuple[str, ...] = ()

    @property
    def rows(self) -> list[FleetRow]:
        """Return the report's row for each channel of each sensor."""
        return [row for outcome in self.outcomes for row in outcome.channels]

    @property
    def summary(self) -> str:
        """Return a sentence that summarises all rows."""
        return summary(self.rows)


def clean(
    spark: SparkSession, lake: Path, output: Path, book: RecipeBook, asked: BatchOptions = DEFAULT_OPTIONS
) -> Fleet:
    """Clean every sensor of a lake. Skip finished sensors whose input has not changed.

    Parameters
    ----------
    spark : SparkSession
        The Spark to use. On every worker, becalm must be installed, and the lake and the output must have these paths.
    lake : Path
        A folder of Parquet files, such as `sensor=17/date=2026-01-02/part-0.parquet`. It is only read.
    output : Path
        The output folder; files have the same names as in the lake. The files of a sensor appear together when the
        sensor is finished. A sensor that shares its input files with others has one output file, such as
        `sensor=17/part-0.parquet`.
    book : RecipeBook
        The recipe of each sensor.
    asked : BatchOptions
        What identifies a sensor, whether estimates use only the past, and the rows of a stretch.

    Raises
    ------
    InputError
        If the lake holds no sensor, or cannot be read.
    UsageError
        If the output overlaps the lake, another job writes to it, or the lake's folders do not identify sensors.
    OutputError
        If the output cannot be written.
    """
    began, started = datetime.now(UTC), monotonic()
    lake, output = lake.resolve(), output.resolve()
    refuse_inside(lake, output)
    layout = find_sensor_layout(lake, asked.by)
    make_folder(output / ABOUT)
    by = FILE if asked.by == FILE else FOLDER  # the output has a folder for each sensor even if a column names it
    tune = "tune FILE -o R.toml" if isinstance(layout, MultiSensorLake) else f"fleet tune {typed(str(lake))} -o DIR"
    job = Job(str(lake), str(output), book.by_hash, by, asked.causal, asked.stretch_rows, f"becalm {tune}")
    with lock_output(output, output / ABOUT / "lock"):
        by_name = sorted(_clean_sensors(spark, job, layout, book), key=lambda outcome: outcome.sensor)
        outcomes = mark_outliers([_with_older(job, outcome) for outcome in by_name])
        remove_leftovers(output)
        rows = sum(outcome.rows for outcome in outcomes)
        facts = FleetFacts(lake.name, output.name, began.isoformat(), monotonic() - started, rows, book.names)
        unused = book.unused(outcome.sensor for outcome in outcomes)
        return _write_report(Fleet(tuple(outcomes), output / ABOUT / "report.html", unused), facts)


def _clean_sensors(
    spark: SparkSession, job: Job, layout: Sequence[SensorPlace] | MultiSensorLake, book: RecipeBook
) -> list[Outcome]:
    if isinstance(layout, MultiSensorLake):
        return clean_grouped(spark, job, layout, book)
    hashes = {place.name: book.hash_for(place.name) for place in layout}
    sensors = [Sensor(place.name, place.bytes, one, place.files) for place in layout if (one := hashes[place.name])]
    sensors.sort(key=lambda sensor: -sensor.bytes)  # the largest first, so that no long task starts near the end
    may_be_long = 2 * job.stretch_rows * _LEAST_BYTES if job.by == FOLDER else np.inf
    long = [sensor for sensor in sensors if sensor.bytes > may_be_long]
    usual = sensors[len(long) :]
    with ThreadPoolExecutor(1) as second_thread:  # each stage uses the cores that the other leaves free
        long_outcomes = second_thread.submit(clean_long, spark, job, long)
        sizes = [sensor.bytes for sensor in usual]
        outcomes = (
            run_tasks(spark, partial(clean_whole, job), usual, sizes, report_lost_sensor) + long_outcomes.result()
        )
    return outcomes + [refused(name, book.why_not(name)) for name, one in hashes.items() if one is None]


def _with_older(job: Job, outcome: Outcome) -> Outcome:
    """Return the outcome; if the sensor was refused and has an older output, add the output's folder to the reason."""
    sensor = Sensor(outcome.sensor, 0, "")
    mark = CompletionMark.of(job.mark_of(sensor)) if outcome.state == "refused" else None
    if mark is None or not mark.files:
        return outcome
    older = f" An older output is still in {job.output_folder(sensor)}."
    return refused(outcome.sensor, outcome.reason + older, outcome.took_s)


def refuse_inside(lake: Path, output: Path) -> None:
    """Raise an error if the output folder is the lake, lies in it, or contains it.

    Raises
    ------
    UsageError
        If the two folders overlap.
    """
    if lake == output or lake in output.parents or output in lake.parents:
        raise UsageError(f"{output} overlaps the lake {lake}, which must stay unchanged. Name another folder with -o.")


def _write_report(fleet: Fleet, facts: FleetFacts) -> Fleet:
    """Write the outcomes and the report page; return the fleet unchanged."""
    lines = [json.dumps(outcome.as_dict()) + "\n" for outcome in fleet.outcomes]
    write_text(fleet.report.with_name("outcomes.jsonl"), "".join(lines))
    write_text(fleet.report, fleet_page(fleet.rows, facts))
    return fleet
