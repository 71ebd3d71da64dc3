"""Define `becalm live`, `becalm journal` and `becalm fleet`, and their options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from becalm.cli import options as o
from becalm.errors import UsageError

THIS_MACHINE = "127.0.0.1"

LiveSource = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE", help="replay:FILE, stdin:, serial:PORT, udp:PORT, mqtt://..., nats://..., visa:..., ni:..."
    ),
]
Sinks = Annotated[
    list[str] | None,
    typer.Option(
        "--sink",
        metavar="SINK",
        help="journal:DIR (the default), stdout:, parquet:DIR, mqtt://..., nats://..., postgres://..., delta:DIR;"
        " may be repeated.",
    ),
]
Learn = Annotated[str, typer.Option("--learn", metavar="30s", help="Duration of tuning if there is no recipe.")]
LiveChannels = Annotated[str | None, typer.Option("--channels", metavar="a,b", help="Filter these channels only.")]
Queue = Annotated[
    int, typer.Option("--queue", metavar="64", help="Largest number of blocks that wait for the filters.")
]
WhenFull = Annotated[
    str,
    typer.Option("--when-full", metavar="block|drop-oldest", help="What to do with a block when the queue is full."),
]
Commit = Annotated[
    str, typer.Option("--commit", metavar="1s", help="Interval of commits of rows, filters and position.")
]
Silent = Annotated[
    str, typer.Option("--silent", metavar="10s", help="Report the source as silent after so long without a row.")
]
Status = Annotated[
    Path | None, typer.Option("--status", metavar="FILE", help="Write the status every second, as JSON.")
]
Metrics = Annotated[
    int | None,
    typer.Option("--metrics", metavar="PORT", help="Serve metrics for Prometheus on this port of this machine."),
]
PagePort = Annotated[
    int | None,
    typer.Option("--page", metavar="PORT", help="Show the stream on a page of this machine; 0 for any free port."),
]
PageHost = Annotated[
    str,
    typer.Option("--page-host", metavar="HOST", help="Address of the page; this machine only by default."),
]
PageToken = Annotated[
    Path | None,
    typer.Option(
        "--token-file", metavar="FILE", help="File of the page's access token, so that it survives a restart."
    ),
]
LogTo = Annotated[
    str, typer.Option("--log", metavar="FILE", help="Log file; - for the error output.", show_default=False)
]


def live(  # noqa: PLR0913  (one argument for each option)
    source: LiveSource,
    recipe: o.RecipeIn = None,
    sink: Sinks = None,
    learn: Learn = "30s",
    lag: o.Lag = None,
    channels: LiveChannels = None,
    queue: Queue = 64,
    when_full: WhenFull = "block",
    commit: Commit = "1s",
    silent: Silent = "10s",
    status: Status = None,
    metrics: Metrics = None,
    page: PagePort = None,
    page_host: PageHost = THIS_MACHINE,
    token_file: PageToken = None,
    log: LogTo = "-",
) -> None:
    """Filter a live stream for weeks; committed rows survive a power cut."""
    from becalm.cli.commands.live import LiveOptions, MonitoringOptions, run, settings_of
    from becalm.web.access import PageOptions

    names = () if channels is None else o.split_names(channels)
    asking = LiveOptions(recipe, learn, o.lag_of(lag), names)
    page_options = None if page is None else PageOptions(page, page_host, token_file)
    if page_options is None and (token_file is not None or page_host != THIS_MACHINE):
        raise UsageError("--page-host and --token-file need a page; give --page PORT too.")
    monitoring = MonitoringOptions(status, metrics, log, silent, page_options)
    run(source, sink or [], asking, settings_of(queue, when_full, commit), monitoring)


# Define `becalm journal` and its options.

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of becalm live --sink journal:DIR.")]
Action = Annotated[str, typer.Argument(metavar="list|verify|export|prune", help="What to do.")]
Exported = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="OUT", help="Output of export; format by file ending."),
]
FromTime = Annotated[
    str | None,
    typer.Option("--from", metavar="TIME", help="First time stamp to export: seconds, or a date: 2026-05-01T12:00."),
]
To = Annotated[str | None, typer.Option("--to", metavar="TIME", help="Time stamp to export up to.")]
Older = Annotated[str | None, typer.Option("--older", metavar="30d", help="Prune files older than this; min, h or d.")]


def journal(  # noqa: PLR0913  (one argument for each option)
    folder: Folder,
    action: Action = "list",
    output: Exported = None,
    start: FromTime = None,
    stop: To = None,
    older: Older = None,
    as_json: o.Json = False,
) -> None:
    """List, verify, export or prune a stream's journal, also while the stream runs."""
    from becalm.cli.commands.journal import DAMAGED, JournalOptions, run

    if not run(folder, action, JournalOptions(output, start, stop, older), as_json=as_json):
        raise typer.Exit(DAMAGED)


# Define `becalm fleet`, its commands and their options.

fleet = typer.Typer(name="fleet", help="Clean a lake of sensors on Spark.", no_args_is_help=True, rich_markup_mode=None)

Lake = Annotated[
    Path,
    typer.Argument(metavar="LAKE", help="Folder of Parquet files: sensor=17/date=2026-01-02/part-0.parquet."),
]
Cleaned = Annotated[Path, typer.Option("-o", "--output", metavar="OUT", help="Output folder; files keep their names.")]
Book = Annotated[
    Path | None,
    typer.Option("--recipes", metavar="DIR", help="Recipes with the layout of the lake: sensor=17.toml, default.toml."),
]
By = Annotated[
    str,
    typer.Option(
        "--by", metavar="folder|file|COLUMN", help="What identifies a sensor: its folder, each file, or a column."
    ),
]
Master = Annotated[
    str | None,
    typer.Option(
        "--master", metavar="URL", help="Spark master: local[4], spark://HOST:7077, yarn; this machine by default."
    ),
]
Settings = Annotated[
    list[str] | None, typer.Option("--conf", metavar="NAME=VALUE", help="Spark setting; may be repeated.")
]
StretchRows = Annotated[
    int | None,
    typer.Option("--stretch", metavar="ROWS", help="Split longer sensors in time, into stretches of so many rows."),
]


@fleet.command()
def clean(  # noqa: PLR0913  (one argument for each option)
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
    """Clean every sensor of a lake; finished sensors are skipped, and a failure does not stop the other sensors."""
    from becalm.cli.commands.fleet import FleetOptions, SparkAddress, clean_lake

    asking = FleetOptions(recipe, recipes, by, causal, stretch)
    clean_lake(lake, output, asking, SparkAddress(master, conf), as_json=as_json)


Recipes = Annotated[
    Path,
    typer.Option("-o", "--output", metavar="RECIPES", help="Output folder of recipes, with the layout of the lake."),
]
MostSensors = Annotated[
    int | None,
    typer.Option("--sensors", metavar="N", help="Number of sensors per class to tune on, evenly spread by name."),
]
Own = Annotated[bool, typer.Option("--own", help="Write separate recipes for sensors that differ from their class.")]
Replace = Annotated[bool, typer.Option("--replace", help="Replace all recipes in the folder.")]


ClassBy = Annotated[
    str, typer.Option("--by", metavar="folder|file", help="What identifies a sensor: its folder, or each file.")
]


@fleet.command()
def tune(  # noqa: PLR0913  (one argument for each option)
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
    """Identify a recipe for each class of sensors, and list sensors that differ from their class."""
    from becalm.cli.commands.fleet import SparkAddress
    from becalm.cli.commands.fleet_tune import tune_lake
    from becalm.fleet.tuning import LakeTuningOptions
    from becalm.fleet.tuning.classes import MOST_SENSORS

    options = LakeTuningOptions(by, causal, MOST_SENSORS if sensors is None else sensors, own, replace)
    tune_lake(lake, output, options, SparkAddress(master, conf), as_json=as_json)


FleetSource = Annotated[
    str, typer.Argument(metavar="SOURCE", help="Growing lake, kafka://HOST:PORT/TOPIC or nats://HOST/S.")
]
Streamed = Annotated[str, typer.Option("-o", "--output", metavar="OUT", help="Output folder.")]
Key = Annotated[str, typer.Option("--by", metavar="COLUMN", help="Column that identifies the sensor.")]
Stamped = Annotated[str, typer.Option("--time", metavar="COLUMN", help="Column of time stamps.")]
Lateness = Annotated[str, typer.Option("--lateness", metavar="5s", help="How long to wait for late rows; s, ms or us.")]
SilentSensors = Annotated[
    str | None,
    typer.Option("--silent", metavar="60s", help="Report a sensor as silent after so long without a row."),
]
Every = Annotated[str, typer.Option("--every", metavar="60s", help="Interval of micro-batches; s, ms or us.")]
Once = Annotated[bool, typer.Option("--once", help="Process the rows that exist now, then stop.")]
Checkpoint = Annotated[
    str, typer.Option("--checkpoint", metavar="DIR", help="Checkpoint folder; OUT/_checkpoint by default.")
]


@fleet.command()
def stream(  # noqa: PLR0913  (one argument for each option)
    source: FleetSource,
    output: Streamed,
    recipe: o.RecipeIn = None,
    recipes: Book = None,
    by: Key = "sensor",
    time: Stamped = "time",
    lateness: Lateness = "0s",
    silent: SilentSensors = None,
    every: Every = "60s",
    once: Once = False,
    checkpoint: Checkpoint = "",
    master: Master = None,
    conf: Settings = None,
) -> None:
    """Filter the rows of all sensors as they arrive; a restart continues from the last commit."""
    from becalm.cli.commands.fleet import SparkAddress
    from becalm.cli.commands.fleet_stream import FleetStreamOptions, TimeoutOptions, stream_sensors

    asking = FleetStreamOptions(recipe, recipes, by, time, TimeoutOptions(lateness, silent, every), checkpoint, once)
    stream_sensors(source, output, asking, SparkAddress(master, conf))
