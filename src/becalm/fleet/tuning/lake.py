"""Tune a lake: tune each chosen sensor in a task, make a recipe for each class, and run it on the class's sensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

from becalm.errors import InputError, UsageError
from becalm.files.atomic_file import make_folder, refuse_unwritable
from becalm.fleet.batch import refuse_inside
from becalm.fleet.job import Job, Sensor
from becalm.fleet.lake import FILE, FOLDER, places_in
from becalm.fleet.outcome import Outcome
from becalm.fleet.output_lock import lock_output
from becalm.fleet.sensor_cleaning import report_lost_sensor
from becalm.fleet.spark_tasks import run_tasks
from becalm.fleet.tuning.classes import MOST_SENSORS, Chosen, TunedClass, chosen_of
from becalm.fleet.tuning.sensor import judge_sensor, tune_sensor
from becalm.fleet.tuning.tuning_output import REPORT, book_of, named_recipes, refuse_recipes, write_found
from becalm.report.fleet.fleet_page import FleetFacts
from becalm.report.fleet.fleet_rows import FleetRow

if TYPE_CHECKING:
    from pyspark.sql import SparkSession

_LOCK = ".lock"

Run = Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]]
"""A function, such as `run_tasks`, that calls a function on each task and returns the results in the order of tasks."""


class LakeTuningOptions(NamedTuple):
    """Options of tuning a lake.

    Attributes
    ----------
    by : {"folder", "file"}
        What identifies a sensor.
    causal : bool
        True for causal filters, false for smoothers.
    most_sensors : int
        Largest number of sensors to tune in each class.
    own : bool
        Whether to write a separate recipe for each sensor that differs from its class.
    replace : bool
        Whether new recipes may replace existing ones.
    """

    by: str = FOLDER
    causal: bool = False
    most_sensors: int = MOST_SENSORS
    own: bool = False
    replace: bool = False


DEFAULT_OPTIONS = LakeTuningOptions()


@dataclass(frozen=True)
class TunedLake:
    """The result of tuning a lake.

    Attributes
    ----------
    classes : tuple of TunedClass
        The classes, sorted by name.
    recipes : tuple of str
        Names of the recipes that were written: "kind=pump" for a class, "kind=pump/sensor=17" for one sensor.
    rows : tuple of FleetRow
        One row for every channel of every sensor that was tuned.
    report : Path
        The report page, which lists the sensors worst first.
    """

    classes: tuple[TunedClass, ...]
    recipes: tuple[str, ...]
    rows: tuple[FleetRow, ...]
    report: Path


def tune(spark: SparkSession, lake: Path, recipes: Path, asked: LakeTuningOptions = DEFAULT_OPTIONS) -> TunedLake:
    """Tune a recipe for each class of a lake, and find the sensors that differ from their class.

    Parameters
    ----------
    spark : SparkSession
        The Spark to use. On every worker, becalm must be installed, and the lake must have this path.
    lake : Path
        A folder of Parquet files, such as `kind=pump/sensor=17/date=2026-01-02/part-0.parquet`. It is only read.
    recipes : Path
        The output folder. Recipes have the layout of the lake: `kind=pump.toml`, and `default.toml` for sensors that
        are in no subfolder. `report.html` and `sensors.jsonl` contain the results.
    asked : LakeTuningOptions
        What identifies a sensor, which sensors are tuned, and how.

    Raises
    ------
    InputError
        If the lake holds no sensor, cannot be read, or no sensor can be tuned.
    UsageError
        If the output folder overlaps the lake, holds recipes although `replace` is false, or is in use by another job;
        or if an option is not valid.
    OutputError
        If the output folder cannot be written.
    """
    return tune_by(partial(run_tasks, spark, lost=report_lost_sensor), lake, recipes, asked)


def tune_by(run: Run, lake: Path, recipes: Path, asked: LakeTuningOptions = DEFAULT_OPTIONS) -> TunedLake:
    """Tune a lake as `tune` does, but run the tasks with the function `run`."""
    began, started = datetime.now(UTC), monotonic()
    lake, recipes = lake.resolve(), recipes.resolve()
    chosen = chosen_in(lake, recipes, asked)
    make_folder(recipes)
    refuse_unwritable(recipes / REPORT)
    with lock_output(recipes, recipes / _LOCK):
        classes = _judge_classes(run, lake, asked.by, chosen, _tune_sensors(run, lake, asked.causal, chosen))
        if not any(klass.found for klass in classes):
            first = classes[0].failed[0]
            raise InputError(f"No sensor of {lake} could be tuned; the first, {first.sensor}: {first.reason}")
        named = named_recipes(classes, own=asked.own)
        names, took_s = tuple(sorted(named)), monotonic() - started
        facts = FleetFacts(lake.name, recipes.name, began.isoformat(), took_s, recipes=names, done="tuned")
        rows = write_found(recipes, classes, named, facts)
        return TunedLake(tuple(classes), names, tuple(rows), recipes / REPORT)


def chosen_in(lake: Path, recipes: Path, asked: LakeTuningOptions = DEFAULT_OPTIONS) -> list[Chosen]:
    """Check the options, and return the classes of a lake with the sensors to tune in each.

    Raises
    ------
    InputError
        If the lake holds no sensor, or cannot be read.
    UsageError
        As `tune`.
    """
    if asked.by not in (FOLDER, FILE):
        raise UsageError(
            f"--by {asked.by} identifies sensors by a column, but classes are folders of sensors. Tune a recipe on the"
            " file of one sensor, becalm tune FILE -o R.toml, and use it with: becalm fleet clean ... --recipe R.toml"
        )
    if asked.most_sensors < 1:
        raise UsageError(f"--sensors {asked.most_sensors} tunes none; give a number above 0, or omit the option.")
    refuse_inside(lake.resolve(), recipes.resolve())
    if not asked.replace:
        refuse_recipes(recipes)
    return chosen_of(places_in(lake, asked.by), asked.most_sensors)


def _tune_sensors(run: Run, lake: Path, causal: bool, chosen: Sequence[Chosen]) -> list[TunedClass]:
    """Tune the chosen sensors, and make the recipe of each class."""
    tasks = _longest_first([Sensor(place.name, place.bytes, "") for one in chosen for place in one.places])
    results = run(partial(tune_sensor, str(lake), causal), tasks)
    by_name = dict(zip((task.name for task in tasks), results, strict=True))
    return [TunedClass.of(one, by_name) for one in chosen]


def _judge_classes(
    run: Run, lake: Path, by: str, chosen: Sequence[Chosen], classes: Sequence[TunedClass]
) -> list[TunedClass]:
    """Run the recipe of each class on the tuned sensors of the class."""
    book = book_of(named_recipes(classes, own=False))
    tuned = {one.sensor for klass in classes if klass.class_recipe is not None for one in klass.found}
    places = [place for one in chosen for place in one.places if place.name in tuned]
    tasks = _longest_first([Sensor(place.name, place.bytes, book.hash_for(place.name) or "") for place in places])
    outcomes: list[Outcome] = run(partial(judge_sensor, Job(str(lake), "", book.by_hash, by)), tasks)
    judged = {outcome.sensor: outcome for outcome in outcomes}
    return [klass.with_judged(judged) for klass in classes]


def _longest_first(sensors: Sequence[Sensor]) -> list[Sensor]:
    """Return sensors sorted by size, the largest first, so that no long task starts near the end of the job."""
    return sorted(sensors, key=lambda sensor: -sensor.bytes)
