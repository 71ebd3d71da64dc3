"""Apply another calibration to a clean recording, without its raw readings."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import NamedTuple

import typer

from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.sensor_files.sensor_file import load_sensors
from becalm.cli.messages import stderr
from becalm.cli.opened_file import recipe_path_of, refuse_overwriting
from becalm.cli.times import refuse_several_time_bases
from becalm.errors import UsageError
from becalm.files.calibrated.recalibrating import recalibrated, recalibrated_blocks
from becalm.files.inputs.opening import close
from becalm.files.outputs.writing import open_output, refuse_columns
from becalm.files.registry import format_to_write, read_tables


class Calibrations(NamedTuple):
    """The sensor file that a recording was cleaned with, and the new one."""

    old: Path
    new: Path


def run(file: Path, output: Path, sensors: Calibrations) -> None:
    """Write a clean recording with the new calibration.

    Raises
    ------
    UsageError
        If there is no recipe next to the recording, there is a recipe of an earlier output next to the new output, the
        output cannot have all time bases of the recording, or the new calibration needs the raw readings.
    """
    format_to_write(output)
    refuse_overwriting(file, output)
    recipe_path = recipe_path_of(file)
    if not recipe_path.exists():
        raise UsageError(f"{recipe_path} does not exist; {file} needs this recipe next to it. Keep the two together.")
    if (earlier := recipe_path_of(output)).exists():
        raise UsageError(f"{earlier} is the recipe of an earlier output; remove it, or give another output with -o.")
    recipe, old, new = Recipe.load(recipe_path), load_sensors(sensors.old), load_sensors(sensors.new)
    tables = read_tables(file)
    try:
        refuse_several_time_bases(output, [table.group for table in tables])
        by_table = recalibrated(tables, recipe, old, new)
        for table in tables:
            refuse_columns(output, table.rows.schema)
        with open_output(output) as out:
            for table, channels in zip(tables, by_table, strict=True):
                for block in recalibrated_blocks(table, channels):
                    out.write(block)
    finally:
        close(tables)
    for one in chain.from_iterable(by_table):
        shift = f", then {'plus' if one.offset > 0 else 'minus'} {abs(one.offset):.6g}" if one.offset else ""
        stderr.print(f"{one.column}: times {one.factor:.6g}{shift}.")
    typer.echo(f"Wrote {output}, without a recipe, because that of {file} is for the old sensors.", err=True)
