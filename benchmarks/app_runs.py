"""`becalm app` in a process of its own, for the benchmarks and tests that look at its page."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
QUIET = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]


class App:
    """`becalm app` in a process of its own."""

    def __init__(self, folder: Path, *words: str, port: int = 0) -> None:
        self.folder, self.words, self.token_file = folder, words, folder.parent / "token"
        self.shows = ""  # the file that is open
        self._start(port)

    def _start(self, port: int) -> None:
        command = [sys.executable, "-m", "becalm", "app", *self.words, "--folder", str(self.folder), "--no-browser"]
        command += ["--port", str(port), "--token-file", str(self.token_file)]
        environment = {**os.environ, "COLUMNS": "1000", "NO_COLOR": "1"}
        self._process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
        assert self._process.stderr is not None
        said = ""
        for line in self._process.stderr:
            said += line
            if found := re.search(r"http://\S+", line):
                self.url = found[0]
                return
        raise AssertionError(f"no address was printed: {said}")

    @property
    def base(self) -> str:
        """Its address, without the token."""
        return self.url.partition("/?")[0]

    def kill(self) -> None:
        """End it as a machine does that loses its power."""
        self._process.kill()
        self._ended()

    def start_again(self) -> None:
        """Start it on the same port."""
        self._start(int(self.base.rpartition(":")[2]))

    def stop(self) -> None:
        """End it as Ctrl-C does."""
        self._process.send_signal(signal.SIGINT)
        self._ended()

    def _ended(self) -> None:
        self._process.wait(60)
        assert self._process.stderr is not None
        self._process.stderr.close()


@contextmanager
def tuner(folder: Path, *words: str) -> Iterator[App]:
    """Serve the files of a folder until the block ends."""
    app = App(folder, *words)
    try:
        yield app
    finally:
        app.stop()
