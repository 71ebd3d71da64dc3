"""Run becalm in a subprocess that serves a page, for the benchmarks and tests of pages."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path


class PageProcess(ABC):
    """A subprocess that serves a page; `url` is the address that it printed, "" until then."""

    url = ""

    @abstractmethod
    def _start(self, port: int) -> None:
        """Start the subprocess with its page at a port; 0 means any free port."""

    def _run(self, words: Sequence[str], folder: Path | None = None, *, served: bool = True) -> None:
        """Start becalm in a folder; with `served`, wait until it has printed the address of its page."""
        command, environment = (
            [sys.executable, "-m", "becalm", *words],
            {**os.environ, "COLUMNS": "1000", "NO_COLOR": "1"},
        )
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment, cwd=folder)
        assert self.process.stderr is not None
        output = ""
        while served:
            line = self.process.stderr.readline()
            output += line
            if found := re.search(r"http://\S+", line):
                self.url = found[0]
                return
            assert line, f"no address was printed: {output}"

    @property
    def base(self) -> str:
        """Return the address of the page, without the token."""
        return self.url.partition("/?")[0]

    def kill(self) -> None:
        """Kill the subprocess with SIGKILL."""
        self.process.kill()
        self._ended()

    def start_again(self) -> None:
        """Start the subprocess again, with its page at the same port."""
        self._start(int(self.base.rpartition(":")[2]))

    def stop(self) -> None:
        """Stop the subprocess with SIGINT, as Ctrl-C does, unless it has ended."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        self._ended()

    def _ended(self) -> None:
        self.process.wait(60)
        assert self.process.stderr is not None
        self.process.stderr.close()
