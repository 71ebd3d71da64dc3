"""Run `becalm live --page` in a subprocess, for the benchmarks and tests of its page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from page_processes import PageProcess


class LiveApp(PageProcess):
    """A subprocess that runs `becalm live` with its page.

    Parameters
    ----------
    folder : Path
        Folder of the journal, the log and the token.
    source : str
        Source, as on the command line.
    words : str
        Further arguments of the command line.
    served : bool
        Whether to serve the page.
    """

    def __init__(self, folder: Path, source: str, *words: str, served: bool = True) -> None:
        self.folder, self.source, self.words, self._served = folder, source, words, served
        self._start(0)

    def _start(self, port: int) -> None:
        files = ["--log", str(self.folder / "live.log"), "--status", str(self.folder / "status.json")]
        page = ["--page", str(port), "--token-file", str(self.folder / "token")] if self._served else []
        self._run(["live", self.source, *self.words, *files, *page], self.folder, served=self._served)


@contextmanager
def shown_live(folder: Path, source: str, *words: str, served: bool = True) -> Iterator[LiveApp]:
    """Run a stream with its page until the block ends."""
    app = LiveApp(folder, source, *words, served=served)
    try:
        yield app
    finally:
        app.stop()
