"""`becalm live --page` in a process of its own, for the benchmarks and tests that look at its page."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class LiveApp:
    """`becalm live` with its page.

    Parameters
    ----------
    folder : Path
        Where journal, log and token are.
    source : str
        As on the command line.
    words : str
        More of it.
    served : bool
        Whether there is a page at all.
    """

    def __init__(self, folder: Path, source: str, *words: str, served: bool = True) -> None:
        self.folder, self.source, self.words = folder, source, words
        self.url = ""
        self._start(0 if served else None)

    def _start(self, port: int | None) -> None:
        command = [sys.executable, "-m", "becalm", "live", self.source, *self.words]
        command += ["--log", str(self.folder / "live.log"), "--status", str(self.folder / "status.json")]
        if port is not None:
            command += ["--page", str(port), "--token-file", str(self.folder / "token")]
        environment = {**os.environ, "COLUMNS": "1000", "NO_COLOR": "1"}
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment, cwd=self.folder)
        assert self.process.stderr is not None
        if port is None:
            return
        said = ""
        for line in self.process.stderr:
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
        self.process.kill()
        self._ended()

    def start_again(self) -> None:
        """Start it on the same port."""
        self._start(int(self.base.rpartition(":")[2]))

    def stop(self) -> None:
        """End it as Ctrl-C does, unless it has ended."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        self._ended()

    def _ended(self) -> None:
        self.process.wait(60)
        assert self.process.stderr is not None
        self.process.stderr.close()


@contextmanager
def shown_live(folder: Path, source: str, *words: str, served: bool = True) -> Iterator[LiveApp]:
    """Show a stream until the block ends."""
    app = LiveApp(folder, source, *words, served=served)
    try:
        yield app
    finally:
        app.stop()
