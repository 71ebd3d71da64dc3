"""Clean a lake whose files hold several sensors each: count rows, split files, merge strips, and clean each sensor."""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from becalm.errors import InputError, UsageError
from becalm.files.atomic_file import make_folder, removed_afterwards
from becalm.files.decoding import Original
from becalm.files.outputs.writing import open_output
from becalm.files.parquet import read_parquet
from becalm.fleet.grouped.counting import Count, count_rows, report_lost_file
from becalm.fleet.grouped.merging import merge_strips
from becalm.fleet.grouped.order import time_of
from becalm.fleet.grouped.strips import Lake, Strip, StripPart, Strips, report_lost_part, split_rows
from becalm.fleet.job import Job, Sensor
from becalm.fleet.lake import MultiSensorLake
from becalm.fleet.names import listed
from becalm.fleet.outcome import Outcome, refused
from becalm.fleet.pieces import open_staging, staging
from becalm.fleet.recipes import RecipeBook
from becalm.fleet.sensor_cleaning import clean_whole, finished, refuse_on_error, report_lost_sensor
from becalm.fleet.spark_tasks import run_tasks
from becalm.fleet.stretching.cleaning import clean_long

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

PART_ROWS = 1 << 22
"""Approximate rows of a file that one task splits: enough work for a task, and little to repeat after a failure."""

OUTPUT = "part-0.parquet"
"""Name of a sensor's only output file."""


class SensorStrips(NamedTuple):
    """A sensor and the strips with all of its rows.

    Attributes
    ----------
    sensor : Sensor
        The sensor.
    strips : tuple of Strip
        All of its rows, in the order of the lake's files.
    """

    sensor: Sensor
    strips: tuple[Strip, ...]

    @property
    def rows(self) -> int:
        """Return the number of rows of the sensor."""
        return sum(strip.rows for strip in self.strips)


def clean_grouped(spark: SparkSession, job: Job, shared: MultiSensorLake, book: RecipeBook) -> list[Outcome]:
    """Clean every sensor of a lake whose files hold several sensors each; skip sensors whose output is up to date.

    Parameters
    ----------
    spark : SparkSession
        The Spark to use.
    job : Job
        The job over the lake.
    shared : MultiSensorLake
        The files, and the keys that identify sensors in them.
    book : RecipeBook
        The recipe of each sensor.

    Raises
    ------
    InputError
        If a file cannot be read or lacks a column that identifies sensors, or no file has a row.
    UsageError
        If a key is the time column.
    OutputError
        If the output cannot be written.
    """
    counts = _count_files(spark, job, shared)
    names = sorted({name for count in counts.values() for name in count.rows})
    if not names:
        raise InputError(f"No file of {job.lake} holds a row; there is nothing to clean.")
    outcomes = [refused(name, book.why_not(name)) for name in names if book.hash_for(name) is None]
    sensors = [_sensor_of(job, name, one, counts) for name in names if (one := book.hash_for(name))]
    kept = {sensor.name: finished(job, sensor, sensor.input_hash) for sensor in sensors}
    outcomes += [one for one in kept.values() if one is not None]
    unfinished = [sensor for sensor in sensors if kept[sensor.name] is None]
    staged = open_staging(Path(job.output))
    with removed_afterwards(staged):
        lake = Lake(job.lake, shared.keys, _time_columns(job, unfinished))
        _refuse_times(job, shared, set(lake.wanted.values()))
        strips = _split_files(spark, lake, staged, counts)
        complete, failed = _group_strips(unfinished, strips)
        return outcomes + failed + _merge_and_clean_all(spark, job.lake, replace(job, lake=str(staged)), complete)


def _count_files(spark: SparkSession, job: Job, shared: MultiSensorLake) -> dict[str, Count]:
    counts = run_tasks(spark, partial(count_rows, job.lake, shared.keys), shared.files, lost=report_lost_file)
    failed = [file for file, count in zip(shared.files, counts, strict=True) if count.failed]
    if failed:
        reason, more = next(count.failed for count in counts if count.failed), failed[1:]
        raise InputError(f"{reason} These files need repair as well: {listed(more)}." if more else reason)
    return dict(zip(shared.files, counts, strict=True))


def _refuse_times(job: Job, shared: MultiSensorLake, asked: Collection[str | None]) -> None:
    """Raise UsageError if a key is a time column; `asked` has the time columns that recipes name, or None."""
    first, times = Path(job.lake) / shared.files[0], set[str]()
    with suppress(InputError):  # the file is damaged; its sensors will be refused later
        table = read_parquet(first, Original(first))
        times = {name for one in asked for name in time_of(table, one)}
    if alike := times & set(shared.keys):
        raise UsageError(f"--by {min(alike)!r} names the time of the rows, not a sensor; name another column.")


def _sensor_of(job: Job, name: str, recipe: str, counts: Mapping[str, Count]) -> Sensor:
    """Return a sensor; its input hash covers the recipe, the options, and every file with rows of this sensor."""
    files = [count.hashed for count in counts.values() if name in count.rows]
    text = json.dumps([job.recipes[recipe], job.asked, files], sort_keys=True)
    return Sensor(name, 0, recipe, input_hash=hashlib.sha256(text.encode()).hexdigest())


def _time_columns(job: Job, sensors: Sequence[Sensor]) -> dict[str, str | None]:
    """Return, by sensor, the time column that its recipe names; None if the recipe names none."""
    by_recipe = {sensor.recipe: sensor for sensor in sensors}
    times = {one: job.recipe_of(sensor).time for one, sensor in by_recipe.items()}
    return {sensor.name: times[sensor.recipe] for sensor in sensors}


def _split_files(
    spark: SparkSession, lake: Lake, staged: Path, counts: Mapping[str, Count]
) -> list[tuple[Count, Strips]]:
    """Split the files with rows of unfinished sensors; return results, each with its file's count, in file order."""
    parts, origins = list[StripPart](), list[Count]()
    for file, count in counts.items():
        shares = -(-sum(count.rows.values()) // PART_ROWS) if lake.wanted.keys() & count.rows.keys() else 0
        for share in range(shares):
            parts.append(StripPart(file, share, shares, str(staged / f"{len(parts):06d}.strips"), count.hashed))
            origins.append(count)
    return list(zip(origins, run_tasks(spark, partial(split_rows, lake), parts, lost=report_lost_part), strict=True))


def _group_strips(
    sensors: Sequence[Sensor], results: Sequence[tuple[Count, Strips]]
) -> tuple[list[SensorStrips], list[Outcome]]:
    """Return complete sensors, the longest first, and refusals of sensors with rows in a file that was not split."""
    strips, failed = defaultdict[str, list[Strip]](list), dict[str, str]()
    for count, part in results:
        failed |= {name: part.failed for name in count.rows if part.failed}
        for name, own in part.by_sensor.items():
            strips[name] += own
    complete = [SensorStrips(sensor, tuple(strips[sensor.name])) for sensor in sensors if sensor.name not in failed]
    outcomes = [refused(sensor.name, failed[sensor.name]) for sensor in sensors if sensor.name in failed]
    return sorted(complete, key=lambda one: -one.rows), outcomes


def _merge_and_clean_all(spark: SparkSession, lake: str, job: Job, complete: Sequence[SensorStrips]) -> list[Outcome]:
    """Merge and clean sensors; long sensors are only merged, and then cleaned in stretches of time."""
    results = run_tasks(spark, partial(merge_and_clean, lake, job), complete, lost=_report_lost)
    long = [one.sensor for one, outcome in zip(complete, results, strict=True) if outcome is None]
    outcomes = [outcome for outcome in results if outcome is not None]
    return outcomes + [_with_lake_names(lake, job.lake, outcome) for outcome in clean_long(spark, job, long)]


def merge_and_clean(lake: str, job: Job, gathered: SensorStrips) -> Outcome | None:
    """Merge the rows of a sensor and clean them; a long sensor is only merged, and the result is None.

    Parameters
    ----------
    lake : str
        The folder of the lake.
    job : Job
        The job; its `lake` is the folder of merged files.
    gathered : SensorStrips
        The sensor and its strips.
    """
    outcome = refuse_on_error(gathered.sensor, lambda: _merge_and_clean(lake, job, gathered))
    return None if outcome is None else _with_lake_names(lake, job.lake, outcome)


def _report_lost(gathered: SensorStrips, why: str) -> Outcome:
    return report_lost_sensor(gathered.sensor, why)


def _merge_and_clean(lake: str, job: Job, gathered: SensorStrips) -> Outcome | None:
    if gathered.rows >= 2 * job.stretch_rows:
        _merge(lake, job, gathered)
        return None
    with staging(Path(job.lake)) as own:  # a folder of this attempt, because an abandoned attempt may still be running
        job = replace(job, lake=str(own))
        _merge(lake, job, gathered)
        return _with_lake_names(lake, job.lake, clean_whole(job, gathered.sensor))


def _merge(lake: str, job: Job, gathered: SensorStrips) -> None:
    path = job.input_of(gathered.sensor) / OUTPUT
    make_folder(path.parent)
    with open_output(path) as out:
        for table in merge_strips(Path(lake), gathered.strips):
            out.write(table)


def _with_lake_names(lake: str, staged: str, outcome: Outcome) -> Outcome:
    """Replace temporary file names in the reason of a refusal by names of the lake; return other outcomes unchanged."""
    if outcome.state != "refused":
        return outcome
    place, reason = f"{staged}/{outcome.sensor}", outcome.reason
    own = f"{outcome.sensor} of {lake}"
    for name, replacement in ((f"{place}/{OUTPUT}", own), (place, own), (staged, lake)):
        reason = reason.replace(name, replacement)
    return refused(outcome.sensor, reason, outcome.took_s)
