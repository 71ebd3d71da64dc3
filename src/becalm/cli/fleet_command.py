"""`becalm fleet`: its commands and options, each with its one help text."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from becalm.cli import options as o

fleet = typer.Typer(
    name="fleet", help="The same filters over a lake of sensors, on Spark.", no_args_is_help=True, rich_markup_mode=None
)

Lake = Annotated[
    Path, typer.Argument(metavar="LAKE", help="Folder of Parquet files, as sensor=17/date=2026-01-02/part-0.parquet.")
]
Cleaned = Annotated[
    Path, typer.Option("-o", "--output", metavar="OUT", help="Folder for as many clean files, of the same names.")
]
Book = Annotated[
    Path | None,
    typer.Option("--recipes", metavar="DIR", help="Recipes laid out as the lake: sensor=17.toml, default.toml."),
]
By = Annotated[
    str,
    typer.Option("--by", metavar="folder|file|COLUMN", help="What tells a sensor: its folder, each file, or a column."),
]
Master = Annotated[
    str | None,
    typer.Option(
        "--master", metavar="URL", help="Where Spark runs: local[4], spark://HOST:7077, yarn; else this machine."
    ),
]
Settings = Annotated[
    list[str] | None, typer.Option("--conf", metavar="NAME=VALUE", help="A setting of Spark; may be repeated.")
]
StretchRows = Annotated[
    int | None,
    typer.Option("--stretch", metavar="ROWS", help="Cut sensors of twice as many rows in time, into such stretches."),
]


@fleet.command()
def clean(  # noqa: PLR0913  (the contract's options)
    lake: Lake,
    output: Cleaned,
    recipe: o.RecipeIn = None,
    recipes: Book = None,
    by: By = "folder",
    causal: o.Causal = False,
    stretch: StretchRows = None,
    master: Master = None,
    conf: Settings = None,
    as_json: o.Json = False,
) -> None:
    """Clean every sensor of a lake; finished ones are left as they are, and none stops the others."""
    from becalm.cli.fleet import Asking, Where, clean_lake

    asking = Asking(recipe, recipes, by, causal, stretch)
    clean_lake(lake, output, asking, Where(master, conf), as_json=as_json)


Recipes = Annotated[
    Path, typer.Option("-o", "--output", metavar="RECIPES", help="Folder for the recipes, laid out as the lake.")
]
MostSensors = Annotated[
    int | None, typer.Option("--sensors", metavar="N", help="Tune so many of each class, evenly spread by name.")
]
Own = Annotated[bool, typer.Option("--own", help="Give sensors that are unlike their class recipes of their own.")]
Replace = Annotated[bool, typer.Option("--replace", help="Put new recipes in the place of all that are in the folder.")]


ClassBy = Annotated[
    str, typer.Option("--by", metavar="folder|file", help="What tells a sensor: its folder, or each file.")
]


@fleet.command()
def tune(  # noqa: PLR0913  (the contract's options)
    lake: Lake,
    output: Recipes,
    by: ClassBy = "folder",
    causal: o.Causal = False,
    sensors: MostSensors = None,
    own: Own = False,
    replace: Replace = False,
    master: Master = None,
    conf: Settings = None,
    as_json: o.Json = False,
) -> None:
    """Find a recipe for each class of sensors, those of one folder, and the sensors that are unlike their class."""
    from becalm.cli.fleet import Where
    from becalm.cli.fleet_tune import tune_lake
    from becalm.fleet.tuning import Asked
    from becalm.fleet.tuning.classes import MOST_SENSORS

    asked = Asked(by, causal, MOST_SENSORS if sensors is None else sensors, own, replace)
    tune_lake(lake, output, asked, Where(master, conf), as_json=as_json)


From = Annotated[
    str, typer.Argument(metavar="SOURCE", help="A lake to which files come, kafka://HOST:PORT/TOPIC or nats://HOST/S.")
]
Streamed = Annotated[str, typer.Option("-o", "--output", metavar="OUT", help="Folder for what is told.")]
Key = Annotated[str, typer.Option("--by", metavar="COLUMN", help="The column that tells whose a row is.")]
Stamped = Annotated[str, typer.Option("--time", metavar="COLUMN", help="The column of stamps.")]
Lateness = Annotated[
    str, typer.Option("--lateness", metavar="5s", help="How long a row waits for earlier ones; s, ms or us.")
]
Silent = Annotated[
    str | None,
    typer.Option("--silent", metavar="60s", help="Without a row for so long, a sensor is called silent."),
]
Every = Annotated[str, typer.Option("--every", metavar="60s", help="How often rows are taken; s, ms or us.")]
Once = Annotated[bool, typer.Option("--once", help="End with what is there now.")]
Checkpoint = Annotated[
    str, typer.Option("--checkpoint", metavar="DIR", help="Where positions and filters are kept; OUT/_checkpoint.")
]


@fleet.command()
def stream(  # noqa: PLR0913  (the contract's options)
    source: From,
    output: Streamed,
    recipe: o.RecipeIn = None,
    recipes: Book = None,
    by: Key = "sensor",
    time: Stamped = "time",
    lateness: Lateness = "0s",
    silent: Silent = None,
    every: Every = "60s",
    once: Once = False,
    checkpoint: Checkpoint = "",
    master: Master = None,
    conf: Settings = None,
) -> None:
    """Filter the rows of all sensors while they come; begun again, it goes on where it was."""
    from becalm.cli.fleet import Where
    from becalm.cli.fleet_stream import Asking, Times, stream_sensors

    asking = Asking(recipe, recipes, by, time, Times(lateness, silent, every), checkpoint, once)
    stream_sensors(source, output, asking, Where(master, conf))
