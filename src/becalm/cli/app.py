"""The app: a page to tune on, served from here until a signal ends it."""

from __future__ import annotations

import os
import re
import signal
import socket
import sys
import threading
import webbrowser
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from becalm.cli.messages import stderr
from becalm.cli.stopping import beside, stop_cleanly
from becalm.errors import InputError, UsageError
from becalm.files.read_options import ReadOptions
from becalm.web.extra import need_app

DEFAULT_PORT = 8765
_SIZE = re.compile(r"(?P<number>\d+\.?\d*|\.\d+)\s*(?P<unit>kb|mb|gb|tb)", re.IGNORECASE)
_BYTES = {"kb": 1e3, "mb": 1e6, "gb": 1e9, "tb": 1e12}
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class TunerFolder(NamedTuple):
    """Whose files may be opened, which is opened first, and what was said of its time."""

    folder: Path
    file: Path | None
    options: ReadOptions


class PageAddress(NamedTuple):
    """Where the page is served, and who keeps its token; without a port the usual one, or any if that is taken."""

    host: str
    port: int | None
    token_file: Path | None


def place_of(file: Path | None, folder: Path | None, options: ReadOptions) -> TunerFolder:
    """Read which files a person wants to work on.

    Raises
    ------
    InputError
        If the file or the folder is not there.
    UsageError
        If the time of no file was told.
    """
    if file is None and options != ReadOptions():
        raise UsageError("--rate and --time are of a file; name it, or give its rate on the page.")
    if file is not None and not file.exists():
        raise InputError(f"{file} is not there; name a recording, or leave it out and choose one on the page.")
    chosen = folder or (Path() if file is None else file.parent)
    if not chosen.is_dir():
        raise InputError(f"{chosen} is no folder; name one with --folder.")
    return TunerFolder(chosen, file, options)


def bytes_of(text: str) -> int:
    """Read how large a file may be.

    Raises
    ------
    UsageError
        If it is no positive number with its unit.
    """
    written = _SIZE.fullmatch(text.strip())
    limit = int(float(written["number"]) * _BYTES[written["unit"].lower()]) if written else 0
    if limit < 1:
        raise UsageError(f"--upload-limit {text} is no size; write a number and then kB, MB or GB, as 2GB.")
    return limit


def run(place: TunerFolder, where: PageAddress, limit_bytes: int, *, browser: bool) -> None:
    """Serve the page until a signal comes; a second one ends at once.

    Raises
    ------
    UsageError
        If a library that serves pages is not here, the port cannot be had, or the token's file is none.
    """
    need_app()
    from becalm.web.access import Access, token_of
    from becalm.web.serving import Server
    from becalm.web.site import Page, html_of, site
    from becalm.web.tuner import Tuner

    token = token_of(where.token_file)
    with _listening(where) as listener:
        access = Access(where.host, listener.getsockname()[1], token)
        tuner = Tuner(place.folder, place.file, limit_bytes, place.options)
        stopped = _hear_signals()
        try:
            with Server(listener, site(Page(html_of("tuner.html"), tuner.wire, tuner.routes), access)):
                stderr.print(f"Open {access.url}\nCtrl-C ends it.")
                if access.warning is not None:
                    stderr.print(access.warning)
                if browser:
                    _show(access.ticket())
                while not stopped.wait(1):  # where signals do not interrupt a wait, they are heard between two
                    pass
        finally:
            tuner.close()


def _listening(where: PageAddress) -> socket.socket:
    from becalm.web.serving import TakenError, listen

    if where.port is not None:
        return listen(where.host, where.port)
    try:
        return listen(where.host, DEFAULT_PORT)
    except TakenError:  # as by another becalm
        return listen(where.host, 0)


def _hear_signals() -> threading.Event:
    """Return what a first signal sets; a second one ends at once."""
    stopped = threading.Event()
    end = beside(stopped.set)

    def stop(number: int, frame: FrameType | None) -> None:
        stop_cleanly()
        end()

    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, stop)
    return stopped


def _show(address: str) -> None:
    """Open the page in a browser with a window; one in the terminal would take that from becalm."""
    windows = sys.platform in ("darwin", "win32") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")))
    if windows:
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
