"""`becalm live --page` in a process of its own, for the benchmarks and tests that look at its page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from page_processes import PageProcess


class LiveApp(PageProcess):
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
        self.folder, self.source, self.words, self._served = folder, source, words, served
        self._start(0)

    def _start(self, port: int) -> None:
        told = ["--log", str(self.folder / "live.log"), "--status", str(self.folder / "status.json")]
        page = ["--page", str(port), "--token-file", str(self.folder / "token")] if self._served else []
        self._run(["live", self.source, *self.words, *told, *page], self.folder, served=self._served)


@contextmanager
def shown_live(folder: Path, source: str, *words: str, served: bool = True) -> Iterator[LiveApp]:
    """Show a stream until the block ends."""
    app = LiveApp(folder, source, *words, served=served)
    try:
        yield app
    finally:
        app.stop()
