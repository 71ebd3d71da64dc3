"""`becalm app`: its options, each with its one help text."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from becalm.cli import options as o

Opened = Annotated[Path | None, typer.Argument(metavar="FILE", help="Recording to begin with.")]
Folder = Annotated[
    Path | None,
    typer.Option(
        "--folder", metavar="DIR", help="Whose files may be opened; FILE's own, or the one becalm is started in."
    ),
]
Port = Annotated[
    int | None, typer.Option("--port", metavar="PORT", help="Where to serve the page; 8765 by default, 0 is any free.")
]
Host = Annotated[
    str, typer.Option("--host", metavar="HOST", help="Who may ask: this machine only, unless another address is named.")
]
TokenFile = Annotated[
    Path | None,
    typer.Option("--token-file", metavar="FILE", help="Keep the token there, so that a page outlives a restart."),
]
UploadLimit = Annotated[
    str, typer.Option("--upload-limit", metavar="2GB", help="How large a file may be that is dropped onto the page.")
]
NoBrowser = Annotated[bool, typer.Option("--no-browser", help="Print the page's address only.")]


def open_app(  # noqa: PLR0913  (the contract's options)
    file: Opened = None,
    rate: o.Rate = None,
    time: o.Time = None,
    folder: Folder = None,
    port: Port = None,
    host: Host = "127.0.0.1",
    token_file: TokenFile = None,
    upload_limit: UploadLimit = "2GB",
    no_browser: NoBrowser = False,
) -> None:
    """Open a page: see raw and clean, turn one dial between noise and lag, save the recipe."""
    from becalm.cli.app import Where, bytes_of, place_of, run
    from becalm.files.asked import ReadOptions

    run(
        place_of(file, folder, ReadOptions(time, rate)),
        Where(host, port, token_file),
        bytes_of(upload_limit),
        browser=not no_browser,
    )
