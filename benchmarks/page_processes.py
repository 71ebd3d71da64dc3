"""becalm in a process of its own that serves a page, for the benchmarks and tests that look at it."""

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
    """A process that prints the address of its page; `url` is empty until it has."""

    url = ""

    @abstractmethod
    def _start(self, port: int) -> None:
        """Start it on a port; 0 is any that is free."""

    def _run(self, words: Sequence[str], folder: Path | None = None, *, served: bool = True) -> None:
        """Run becalm in a folder, until its page is served if there is one."""
        command, environment = (
            [sys.executable, "-m", "becalm", *words],
            {**os.environ, "COLUMNS": "1000", "NO_COLOR": "1"},
        )
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment, cwd=folder)
        assert self.process.stderr is not None
        said = ""
        while served:
            line = self.process.stderr.readline()
            said += line
            if found := re.search(r"http://\S+", line):
                self.url = found[0]
                return
            assert line, f"no address was printed: {said}"

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
