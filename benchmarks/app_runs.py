"""Run `becalm app` in a subprocess, for the benchmarks and tests of its page."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from page_processes import PageProcess

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
QUIET = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]


class App(PageProcess):
    """A subprocess that runs `becalm app`."""

    def __init__(self, folder: Path, *words: str, port: int = 0) -> None:
        self.folder, self.words, self.token_file = folder, words, folder.parent / "token"
        self.shows = ""  # the file that is open
        self._start(port)

    def _start(self, port: int) -> None:
        where = ["--folder", str(self.folder), "--port", str(port), "--token-file", str(self.token_file)]
        self._run(["app", *self.words, *where, "--no-browser"])


@contextmanager
def tuner(folder: Path, *words: str) -> Iterator[App]:
    """Serve the files of a folder until the block ends."""
    app = App(folder, *words)
    try:
        yield app
    finally:
        app.stop()
