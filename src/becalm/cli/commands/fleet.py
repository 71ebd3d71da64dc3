"""Clean a lake on Spark; check all options before Spark starts, because its start takes seconds."""

from __future__ import annotations

import json
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from becalm.cli.stopping import stop_cleanly
from becalm.errors import NOT_DESCRIBED, UsageError
from becalm.fleet.batch import BatchOptions, Fleet, clean, refuse_inside
from becalm.fleet.job import STRETCH_ROWS
from becalm.fleet.lake import find_sensor_layout
from becalm.fleet.names import listed
from becalm.fleet.recipes import open_book
from becalm.fleet.session import session

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pyspark.sql import SparkSession

_MOST_NAMED = 5  # largest number of sentences that `print_some` prints
_STOPPED = b"becalm: Stopped; what is finished stays, and half-written files are not read. Repeat it to continue.\n"


class FleetOptions(NamedTuple):
    """The options for cleaning a lake."""

    recipe: Path | None
    recipes: Path | None
    by: str
    causal: bool
    stretch_rows: int | None


class SparkAddress(NamedTuple):
    """The address and the settings of Spark, as they were typed."""

    master: str | None
    settings: Sequence[str] | None

    @property
    def spark(self) -> dict[str, str]:
        """Return the settings of Spark, by name.

        Raises
        ------
        UsageError
            If a setting has no name or no value.
        """
        settings = dict[str, str]()
        for setting in self.settings or ():
            name, equals, value = setting.partition("=")
            if not (name and equals):
                missing = "value" if name else "name"
                raise UsageError(f"--conf {setting} has no {missing}; write it like --conf spark.executor.memory=4g.")
            settings[name.strip()] = value.strip()
        return settings


@contextmanager
def spark_at(where: SparkAddress, *, schedules: bool = True) -> Iterator[SparkSession]:
    """Start Spark in a `with`. A signal ends the process at once, with a message on unfinished work.

    Raises
    ------
    UsageError
        As in `becalm.fleet.session`, or if a setting has no name or no value.
    """
    with session(where.master, where.spark, schedules=schedules) as spark:
        stop_cleanly(_STOPPED)  # set again, because Spark has replaced the handler of SIGINT
        yield spark


def clean_lake(lake: Path, output: Path, asking: FleetOptions, where: SparkAddress, *, as_json: bool) -> None:
    """Clean a lake; print the summary and the path of the report.

    Raises
    ------
    BecalmError
        As in `becalm.fleet.clean`, or if an option is invalid or Spark does not start.
    Exit
        With exit code `NOT_DESCRIBED` if a sensor was refused, or a model does not describe its sensor.
    """
    if asking.stretch_rows is not None and asking.stretch_rows < 1:
        raise UsageError(f"--stretch {asking.stretch_rows} is not a number of rows; give 1 or more, or leave it out.")
    book = open_book(asking.recipe, asking.recipes)
    refuse_inside(lake.resolve(), output.resolve())
    find_sensor_layout(lake, asking.by)
    options = BatchOptions(asking.by, asking.causal or None, asking.stretch_rows or STRETCH_ROWS)
    with spark_at(where) as spark:
        fleet = clean(spark, lake, output, book, options)
    _print_results(fleet, output, as_json=as_json)
    if not all(outcome.describes for outcome in fleet.outcomes):
        raise typer.Exit(NOT_DESCRIBED)


def print_some(sentences: Sequence[str]) -> None:
    """Print the first sentences of a list, and the number of sentences left out."""
    for sentence in sentences[:_MOST_NAMED]:
        typer.echo(sentence, err=True)
    if len(sentences) > _MOST_NAMED:
        typer.echo(f"and {len(sentences) - _MOST_NAMED} more, see the report.", err=True)


def _print_results(fleet: Fleet, output: Path, *, as_json: bool) -> None:
    typer.echo(fleet.summary, err=True)
    print_some([f"{one.sensor}: {one.reason}" for one in fleet.outcomes if one.state == "refused"])
    if fleet.unused:
        typer.echo(f"These recipes match no sensor: {listed(fleet.unused)}.", err=True)
    typer.echo(f"Wrote {output} and its report, {fleet.report}.", err=True)
    if as_json:
        results = {
            "output": str(output),
            "report": str(fleet.report),
            "unused": fleet.unused,
            "sensors": [one.as_dict() for one in fleet.outcomes],
        }
        print(json.dumps(results, indent=2))  # noqa: T201
