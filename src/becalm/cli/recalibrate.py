"""A clean recording with another calibration, without its readings."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import NamedTuple

import typer

from becalm.cleaning.recipe import Recipe
from becalm.cleaning.sensor_file import load_sensors
from becalm.cli.messages import stderr
from becalm.cli.opened_file import recipe_beside, refuse_overwriting
from becalm.cli.times import refuse_times
from becalm.errors import UsageError
from becalm.files.opening import close
from becalm.files.recalibrating import recalibrated, recalibrated_blocks
from becalm.files.registry import format_to_write, read_tables
from becalm.files.writing import open_output, refuse_columns


class Calibrations(NamedTuple):
    """The sensor file that a recording was cleaned with, and the one it should have been."""

    old: Path
    new: Path


def run(file: Path, output: Path, sensors: Calibrations) -> None:
    """Write a clean recording as the new calibration has it.

    Raises
    ------
    UsageError
        If its recipe is not beside it, it holds several times and the output one, or it cannot be had without the
        readings.
    """
    format_to_write(output)
    refuse_overwriting(file, output)
    beside = recipe_beside(file)
    if not beside.exists():
        raise UsageError(f"{beside} is not there, which says how {file} was cleaned; keep the two together.")
    recipe, old, new = Recipe.load(beside), load_sensors(sensors.old), load_sensors(sensors.new)
    tables = read_tables(file)
    try:
        refuse_times(output, [table.group for table in tables])
        of_tables = recalibrated(tables, recipe, old, new)
        for table in tables:
            refuse_columns(output, table.rows.schema)
        with open_output(output) as out:
            for table, channels in zip(tables, of_tables, strict=True):
                for block in recalibrated_blocks(table, channels):
                    out.write(block)
    finally:
        close(tables)
    for one in chain.from_iterable(of_tables):
        shift = f" {'+' if one.offset > 0 else '-'} {abs(one.offset):.6g}" if one.offset else ""
        stderr.print(f"{one.column}: times {one.factor:.6g}{shift}.")
    typer.echo(f"Wrote {output}; no recipe, since that of {file} is for the old sensors.", err=True)
