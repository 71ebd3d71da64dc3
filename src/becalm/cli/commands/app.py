"""Run the app: serve the tuner page until a signal stops it."""

from __future__ import annotations

import os
import re
import signal
import socket
import sys
import threading
import webbrowser
from math import inf
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from becalm.cli.messages import stderr
from becalm.cli.stopping import call_in_thread, stop_cleanly
from becalm.errors import InputError, UsageError
from becalm.files.read_options import ReadOptions
from becalm.web.needed_libraries import need_app

DEFAULT_PORT = 8765
_SIZE = re.compile(r"(?P<number>\d+\.?\d*|\.\d+)\s*(?P<unit>kb|mb|gb|tb)", re.IGNORECASE)
_BYTES = {"kb": 1e3, "mb": 1e6, "gb": 1e9, "tb": 1e12}
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))


class TunerFolder(NamedTuple):
    """The folder of the files that the page may open, the file to open first, and the time options of that file."""

    folder: Path
    file: Path | None
    options: ReadOptions


class PageAddress(NamedTuple):
    """The address of the page, and the file of its token. If `port` is None, it is `DEFAULT_PORT` or any free port."""

    host: str
    port: int | None
    token_file: Path | None


def place_of(file: Path | None, folder: Path | None, options: ReadOptions) -> TunerFolder:
    """Return the folder and the first file of the page.

    Raises
    ------
    InputError
        If the file or the folder does not exist.
    UsageError
        If there are time options, but no file.
    """
    if file is None and options != ReadOptions():
        raise UsageError("--rate and --time need a FILE; name one, or give its rate on the page.")
    if file is not None and not file.exists():
        raise InputError(f"{file} does not exist; name a recording, or leave it out and choose one on the page.")
    chosen = folder or (Path() if file is None else file.parent)
    if not chosen.is_dir():
        raise InputError(f"{chosen} is not a folder; name one with --folder.")
    return TunerFolder(chosen, file, options)


def bytes_of(text: str) -> int:
    """Return a size in bytes, from a text such as "2GB".

    Raises
    ------
    UsageError
        If the text is not a positive number with a unit.
    """
    match = _SIZE.fullmatch(text.strip())
    limit = float(match["number"]) * _BYTES[match["unit"].lower()] if match else 0.0
    if not 1 <= limit < inf:
        raise UsageError(f"--upload-limit {text} is not a size; write a number and then kB, MB or GB, such as 2GB.")
    return int(limit)


def run(place: TunerFolder, where: PageAddress, limit_bytes: int, *, browser: bool) -> None:
    """Serve the page until a signal arrives; a second signal ends the process at once.

    Raises
    ------
    UsageError
        If a library that serves pages is not installed, the port cannot be used, or the token file has no token.
    """
    need_app()
    from becalm.web.access import Access, token_of
    from becalm.web.serving import Server
    from becalm.web.site import Page, html_of, site
    from becalm.web.tuner import Tuner

    token = token_of(where.token_file)
    with _open_listener(where) as listener:
        access = Access(where.host, listener.getsockname()[1], token)
        tuner = Tuner(place.folder, place.file, limit_bytes, place.options)
        stopped = _catch_signals()
        try:
            with Server(listener, site(Page(html_of("tuner.html"), tuner.wire, tuner.routes), access)):
                stderr.print(f"Open {access.url}\nCtrl-C ends it.")
                if access.warning is not None:
                    stderr.print(access.warning)
                if browser:
                    _open_browser(access.ticket())
                while not stopped.wait(1):  # a short timeout, because signals do not interrupt a wait on all systems
                    pass
        finally:
            tuner.close()


def _open_listener(where: PageAddress) -> socket.socket:
    from becalm.web.serving import PortInUseError, listen

    if where.port is not None:
        return listen(where.host, where.port)
    try:
        return listen(where.host, DEFAULT_PORT)
    except PortInUseError:  # another process, such as another becalm, uses the port
        return listen(where.host, 0)


def _catch_signals() -> threading.Event:
    """Return an event that the first signal sets; a second signal ends the process at once."""
    stopped = threading.Event()
    end = call_in_thread(stopped.set)

    def stop(number: int, frame: FrameType | None) -> None:
        stop_cleanly()
        end()

    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, stop)
    return stopped


def _open_browser(address: str) -> None:
    """Open the page in a graphical browser, if there is one; a text browser would occupy the terminal."""
    windows = sys.platform in ("darwin", "win32") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")))
    if windows:
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
