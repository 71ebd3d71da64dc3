"""Define `becalm app` and its options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from becalm.cli import options as o

Opened = Annotated[Path | None, typer.Argument(metavar="FILE", help="Recording to open first.")]
Folder = Annotated[
    Path | None,
    typer.Option(
        "--folder", metavar="DIR", help="Folder whose files may be opened; by default FILE's, or the current one."
    ),
]
Port = Annotated[
    int | None, typer.Option("--port", metavar="PORT", help="Port of the page; 8765 by default, 0 for any free port.")
]
Host = Annotated[
    str, typer.Option("--host", metavar="HOST", help="Address to listen on; this machine only by default.")
]
TokenFile = Annotated[
    Path | None,
    typer.Option("--token-file", metavar="FILE", help="File of the access token, so that it survives a restart."),
]
UploadLimit = Annotated[str, typer.Option("--upload-limit", metavar="2GB", help="Largest file that may be uploaded.")]
NoBrowser = Annotated[bool, typer.Option("--no-browser", help="Do not open a browser; print the address only.")]


def open_app(  # noqa: PLR0913  (one argument for each option)
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
    """Open the tuner in a browser: raw and clean signal, one dial between noise and lag."""
    from becalm.cli.app import PageAddress, bytes_of, place_of, run
    from becalm.files.read_options import ReadOptions

    run(
        place_of(file, folder, ReadOptions(time, rate)),
        PageAddress(host, port, token_file),
        bytes_of(upload_limit),
        browser=not no_browser,
    )
