"""Define `becalm journal` and its options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from becalm.cli import options as o

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of becalm live --sink journal:DIR.")]
Action = Annotated[str, typer.Argument(metavar="list|verify|export|prune", help="What to do.")]
Exported = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="OUT", help="Output of export; format by file ending."),
]
From = Annotated[
    str | None,
    typer.Option("--from", metavar="TIME", help="First time stamp to export: seconds, or a date: 2026-05-01T12:00."),
]
To = Annotated[str | None, typer.Option("--to", metavar="TIME", help="Time stamp to export up to.")]
Older = Annotated[str | None, typer.Option("--older", metavar="30d", help="Prune files older than this; min, h or d.")]


def journal(  # noqa: PLR0913  (one argument for each option)
    folder: Folder,
    action: Action = "list",
    output: Exported = None,
    start: From = None,
    stop: To = None,
    older: Older = None,
    as_json: o.Json = False,
) -> None:
    """List, verify, export or prune a stream's journal, also while the stream runs."""
    from becalm.cli.journal import DAMAGED, JournalOptions, run

    if not run(folder, action, JournalOptions(output, start, stop, older), as_json=as_json):
        raise typer.Exit(DAMAGED)
