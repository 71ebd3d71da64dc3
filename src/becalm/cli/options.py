"""The options that commands share, each with its one help text."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated

import typer

Source = Annotated[Path, typer.Argument(metavar="FILE", help="Recording: CSV (also gzipped) or Parquet.")]
Output = Annotated[Path, typer.Option("-o", "--output", metavar="OUT", help="Where to write; format by file ending.")]
RecipeOut = Annotated[Path, typer.Option("-o", "--output", metavar="R.toml", help="Where to write the recipe.")]
RecipeIn = Annotated[Path | None, typer.Option("--recipe", metavar="R.toml", help="Do as this recipe says.")]
Channels = Annotated[
    str | None, typer.Option("--channels", metavar="a,b", help="Clean these channels; the others pass through.")
]
Rate = Annotated[
    float | None, typer.Option("--rate", metavar="HZ", help="Count rows at this rate; replaces the time column.")
]
Time = Annotated[str | None, typer.Option("--time", metavar="COLUMN", help="Name of the time column.")]
Causal = Annotated[bool, typer.Option("--causal", help="Let each estimate know only the past, as a live filter does.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]


def split_names(text: str) -> tuple[str, ...]:
    """Split a list of names at its commas; a name with a comma goes in double quotes."""
    return tuple(name.strip() for name in next(csv.reader([text], skipinitialspace=True), []) if name.strip())
