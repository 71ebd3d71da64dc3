"""Define `becalm live` and its options."""

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
LiveChannels = Annotated[
    str | None, typer.Option("--channels", metavar="a,b", help="Tune filters for these channels only.")
]
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
    from becalm.cli.live import LiveOptions, Watching, run, settings_of
    from becalm.web.access import PageAsked

    names = () if channels is None else o.split_names(channels)
    asking = LiveOptions(recipe, learn, o.lag_of(lag), names)
    page_options = None if page is None else PageAsked(page, page_host, token_file)
    if page_options is None and (token_file is not None or page_host != THIS_MACHINE):
        raise UsageError("--page-host and --token-file need a page; give --page PORT too.")
    watching = Watching(status, metrics, log, silent, page_options)
    run(source, sink or [], asking, settings_of(queue, when_full, commit), watching)
