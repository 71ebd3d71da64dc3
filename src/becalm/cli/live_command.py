"""`becalm live`: its options, each with its one help text."""

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
Learn = Annotated[str, typer.Option("--learn", metavar="30s", help="How long to learn where there is no recipe.")]
LiveChannels = Annotated[
    str | None, typer.Option("--channels", metavar="a,b", help="Learn filters for these channels only.")
]
Queue = Annotated[int, typer.Option("--queue", metavar="64", help="Blocks that may wait for the filters.")]
WhenFull = Annotated[
    str,
    typer.Option("--when-full", metavar="block|drop-oldest", help="What becomes of a block that finds the queue full."),
]
Commit = Annotated[
    str, typer.Option("--commit", metavar="1s", help="How often rows, filters and position are kept together.")
]
Silent = Annotated[
    str, typer.Option("--silent", metavar="10s", help="After how long without a row the source is called silent.")
]
Status = Annotated[
    Path | None, typer.Option("--status", metavar="FILE", help="Say every second how the stream fares, as JSON.")
]
Metrics = Annotated[
    int | None, typer.Option("--metrics", metavar="PORT", help="Tell Prometheus the same, on this machine's port.")
]
PagePort = Annotated[
    int | None, typer.Option("--page", metavar="PORT", help="Show the stream on a page of this machine; 0: any port.")
]
PageHost = Annotated[
    str,
    typer.Option("--page-host", metavar="HOST", help="Who may look on: this machine only, unless another is named."),
]
PageToken = Annotated[
    Path | None,
    typer.Option("--token-file", metavar="FILE", help="Keep the page's token here, so that it outlives a restart."),
]
LogTo = Annotated[
    str, typer.Option("--log", metavar="FILE", help="Where to log; - writes to the error output.", show_default=False)
]


def live(  # noqa: PLR0913  (the contract's options)
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
    """Filter a stream while it comes, for weeks; what was kept outlives a power cut."""
    from becalm.cli.live import Asking, Watching, run, settings_of
    from becalm.web.access import PageAsked

    named = () if channels is None else o.split_names(channels)
    asking = Asking(recipe, learn, o.lag_of(lag), named)
    shown = None if page is None else PageAsked(page, page_host, token_file)
    if shown is None and (token_file is not None or page_host != THIS_MACHINE):
        raise UsageError("--page-host and --token-file are of a page, and none is asked for; give --page PORT too.")
    watching = Watching(status, metrics, log, silent, shown)
    run(source, sink or [], asking, settings_of(queue, when_full, commit), watching)
