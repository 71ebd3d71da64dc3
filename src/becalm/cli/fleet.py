"""A lake cleaned on Spark: what is asked is checked before Spark starts, which takes seconds."""

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
from becalm.fleet.lake import told_apart
from becalm.fleet.names import listed
from becalm.fleet.recipes import open_book
from becalm.fleet.session import session

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pyspark.sql import SparkSession

_MOST_NAMED = 5  # sensors
_STOPPED = b"becalm: Stopped; what is finished stays, and what was half-written is not read. Repeat, and it goes on.\n"


class FleetOptions(NamedTuple):
    """What is asked of a lake."""

    recipe: Path | None
    recipes: Path | None
    by: str
    causal: bool
    stretch_rows: int | None


class SparkAddress(NamedTuple):
    """Where Spark runs, and how."""

    master: str | None
    settings: Sequence[str] | None

    @property
    def spark(self) -> dict[str, str]:
        """Spark's own settings.

        Raises
        ------
        UsageError
            If one has no value.
        """
        told = dict[str, str]()
        for setting in self.settings or ():
            name, equals, value = setting.partition("=")
            if not (name and equals):
                raise UsageError(f"--conf {setting} has no value; write it as --conf spark.executor.memory=4g.")
            told[name.strip()] = value.strip()
        return told


@contextmanager
def spark_at(where: SparkAddress, *, schedules: bool = True) -> Iterator[SparkSession]:
    """Give Spark; signals still stop at once, and say what becomes of what its workers were at.

    Raises
    ------
    UsageError
        As `becalm.fleet.session`.
    """
    with session(where.master, where.spark, schedules=schedules) as spark:
        stop_cleanly(_STOPPED)  # Spark has taken SIGINT
        yield spark


def clean_lake(lake: Path, output: Path, asking: FleetOptions, where: SparkAddress, *, as_json: bool) -> None:
    """Clean a lake; say what became of it, and where the report is.

    Raises
    ------
    Exit
        With another code than 0 where a sensor was refused, or is not described by its model.
    """
    if asking.stretch_rows is not None and asking.stretch_rows < 1:
        raise UsageError(f"--stretch {asking.stretch_rows} is no number of rows; give one above 0, or leave it out.")
    book = open_book(asking.recipe, asking.recipes)
    refuse_inside(lake.resolve(), output.resolve())
    told_apart(lake, asking.by)
    asked = BatchOptions(asking.by, asking.causal or None, asking.stretch_rows or STRETCH_ROWS)
    with spark_at(where) as spark:
        fleet = clean(spark, lake, output, book, asked)
    _tell(fleet, output, as_json=as_json)
    if not all(outcome.describes for outcome in fleet.outcomes):
        raise typer.Exit(NOT_DESCRIBED)


def say_some(sentences: Sequence[str]) -> None:
    """Say the first of some sentences, and how many more there are."""
    for sentence in sentences[:_MOST_NAMED]:
        typer.echo(sentence, err=True)
    if len(sentences) > _MOST_NAMED:
        typer.echo(f"and {len(sentences) - _MOST_NAMED} more, which the report names.", err=True)


def _tell(fleet: Fleet, output: Path, *, as_json: bool) -> None:
    typer.echo(fleet.summary, err=True)
    say_some([f"{one.sensor}: {one.reason}" for one in fleet.outcomes if one.state == "refused"])
    if fleet.unused:
        typer.echo(f"No sensor has these recipes, by their names: {listed(fleet.unused)}.", err=True)
    typer.echo(f"Wrote {output} and its report, {fleet.report}.", err=True)
    if as_json:
        told = {
            "output": str(output),
            "report": str(fleet.report),
            "unused": fleet.unused,
            "sensors": [one.as_dict() for one in fleet.outcomes],
        }
        print(json.dumps(told, indent=2))  # noqa: T201
