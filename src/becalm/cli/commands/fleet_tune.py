"""Tune recipes for a lake on Spark; check all options before Spark starts, because its start takes seconds."""

from __future__ import annotations

import json
from pathlib import Path

import typer

from becalm.cli.commands.fleet import SparkAddress, print_some, spark_at
from becalm.errors import NOT_DESCRIBED
from becalm.fleet.lake import FILE
from becalm.fleet.tuning.lake import LakeTuningOptions, TunedLake, chosen_in, tune
from becalm.fleet.tuning.tuning_output import values_of
from becalm.installation import typed
from becalm.report.fleet.fleet_rows import counted


def tune_lake(lake: Path, output: Path, asked: LakeTuningOptions, where: SparkAddress, *, as_json: bool) -> None:
    """Tune recipes for a lake; print the results and the path of the report.

    Raises
    ------
    BecalmError
        As in `becalm.fleet.tuning.tune`, or if Spark does not start.
    Exit
        With exit code `NOT_DESCRIBED` if a sensor was refused, or a class has no recipe.
    """
    chosen_in(lake, output, asked)
    with spark_at(where) as spark:
        tuned = tune(spark, lake, output, asked)
    _print_results(lake, output, asked, tuned)
    if as_json:
        results = {"recipes": tuned.recipes, "report": str(tuned.report), "sensors": values_of(tuned.classes)}
        print(json.dumps({"output": str(output), **results}, indent=2))  # noqa: T201
    if any(klass.class_recipe is None for klass in tuned.classes) or any(row.state == "refused" for row in tuned.rows):
        raise typer.Exit(NOT_DESCRIBED)


def _print_results(lake: Path, output: Path, options: LakeTuningOptions, tuned: TunedLake) -> None:
    for klass in tuned.classes:
        typer.echo(klass.says, err=True)
    print_some([f"{row.sensor}: {row.reason}" for row in tuned.rows if row.state == "refused"])
    outlying = [row for row in tuned.rows if row.outlying]
    print_some([f"{row.sensor}, {row.channel}: {row.outlying}" for row in outlying])
    if outlying and not options.own:
        advice = "To write separate recipes for the sensors that differ from their class, repeat with --own --replace."
        typer.echo(advice, err=True)
    if not tuned.recipes:
        typer.echo(f"No recipe was written; the report is {tuned.report}.", err=True)
        return
    by = " --by file" if options.by == FILE else ""
    typer.echo(
        f"Wrote {counted(len(tuned.recipes), 'recipe', 'recipes')} into {output} and a report, {tuned.report}. Use them"
        f" with: becalm fleet clean {typed(str(lake))} -o OUT --recipes {typed(str(output))}{by}",
        err=True,
    )
