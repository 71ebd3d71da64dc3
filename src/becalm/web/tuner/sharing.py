"""What all pages of a tuner have in common: the folder, what is open, and the threads that compute."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol, TypeVar

from becalm.errors import BecalmError, InputError, UsageError
from becalm.files.read_options import ReadOptions
from becalm.files.registry import endings_here
from becalm.installation import load_scipy, version
from becalm.web.tuner.folder import READ_ENDINGS, Folder
from becalm.web.tuner.opened import AS_IT_IS, Opened
from becalm.web.tuner.view_model import ViewModel
from becalm.web.uploads import Uploads

_HALVES, _WORKERS = 2, 6

T = TypeVar("T")
Telling = Callable[[Any], Coroutine[Any, Any, None]]
"""Tells a page something."""


class Hearer(Protocol):
    """A page that is open."""

    def tell(self, what: Telling) -> None:
        """Tell it something beside all else."""
        ...


class Shared:
    """What pages have in common.

    Parameters
    ----------
    folder : Path
        Whose files may be opened.
    file : Path or None
        What is opened first.
    upload_limit : int
        Bytes of a file that a page may bring.
    options : ReadOptions
        What was said of the time of the file that is opened first.
    """

    def __init__(self, folder: Path, file: Path | None, upload_limit: int, options: ReadOptions = AS_IT_IS) -> None:
        self._options = options
        self.folder = Folder(folder, file)
        self.uploads = Uploads(upload_limit)
        load_scipy()
        self.halves = ThreadPoolExecutor(_HALVES, thread_name_prefix="becalm-half")
        self.workers = ThreadPoolExecutor(_WORKERS, thread_name_prefix="becalm-tuner")
        self.pages: set[Hearer] = set()
        self.desk: ViewModel | None = None
        self._opening = asyncio.Lock()
        self._openings: set[asyncio.Task[None]] = set()
        self._run = secrets.token_hex(8)

    @property
    def first(self) -> str | None:
        """The file that is opened first, as pages call it."""
        return self.folder.first

    def welcome(self) -> dict[str, Any]:
        """Tell a page where it is."""
        return {
            "kind": "welcome",
            "version": version(),
            "run": self._run,
            **self.files(),
            "file": self.first if self.desk is None else self.desk.opened.id,
            "saves": endings_here(),
        }

    def files(self) -> dict[str, Any]:
        """Tell a page what it may open now."""
        return {
            "folder": self.folder.name,
            "files": [one.as_dict() for one in self.folder.known()],
            "upload_limit": self.uploads.limit_bytes,
            "formats": list(READ_ENDINGS),
        }

    def is_open(self, file: str, group: str | None, rate_hz: float | None) -> bool:
        """Whether a file is the one that is open, unchanged since it was read, or deleted since."""
        if self.desk is None or self.desk.opened.id != file or group not in (None, self.desk.opened.group):
            return False
        if rate_hz not in (None, self.desk.opened.said.rate_hz):
            return False
        try:
            path = self.folder.path_of(file)
        except InputError:  # it is gone, but was read
            return True
        return self.desk.opened.is_unchanged(path)

    async def open(self, file: str, group: str | None, rate_hz: float | None = None) -> None:
        """Open a file in the place of what is open; what is open stays where it cannot be read.

        Raises
        ------
        BecalmError
            If it cannot be read.
        """
        opening = asyncio.create_task(self._open(file, group, rate_hz))
        self._openings.add(opening)  # which goes on where the page that asked is reloaded: it will ask again
        opening.add_done_callback(self._opened)
        await asyncio.shield(opening)

    def _opened(self, opening: asyncio.Task[None]) -> None:
        self._openings.discard(opening)
        if not opening.cancelled():
            opening.exception()  # whoever asks again is told; asyncio need not complain that nobody looked

    async def _open(self, file: str, group: str | None, rate_hz: float | None) -> None:
        async with self._opening:
            if self.is_open(file, group, rate_hz):
                return  # another page asked for it as well
            options = self._options if file == self.first else AS_IT_IS
            if rate_hz is not None:
                options = ReadOptions(rate_hz=rate_hz)
            path, loop = self.folder.path_of(file), asyncio.get_running_loop()

            def tell(says: str) -> None:
                asyncio.run_coroutine_threadsafe(self.working(says), loop)

            def begin() -> ViewModel:
                try:
                    desk = ViewModel(Opened(file, path, group, tell, options))
                    desk.begin()
                except BecalmError as cause:  # a page knows files by name, and has a field for their rate
                    said = str(cause).replace(str(path), path.name).replace("--rate HZ", "the rate (Hz) below")
                    raise type(cause)(said) from cause
                return desk

            try:
                self.desk = await loop.run_in_executor(self.workers, begin)
            except BaseException:
                await self.working("")
                raise

    async def tell_all(self, what: Telling, asker: Hearer | None) -> None:
        """Tell every page something; only the one that asked for it is waited for."""
        for page in tuple(self.pages):
            if page is not asker:
                page.tell(what)
        if asker is not None:
            await what(asker)

    async def in_thread(self, work: Callable[[], T]) -> T:
        """Do some work in a thread."""
        return await asyncio.get_running_loop().run_in_executor(self.workers, work)

    @property
    def open_desk(self) -> ViewModel:
        """What is worked on.

        Raises
        ------
        UsageError
            If nothing is open.
        """
        if self.desk is None:
            raise UsageError("Nothing is open yet; choose a file, or drop one here.")
        return self.desk

    def close(self) -> None:
        """End the threads, and remove what was brought."""
        for pool in (self.workers, self.halves):
            pool.shutdown(wait=False, cancel_futures=True)
        self.uploads.close()

    async def working(self, says: str) -> None:
        """Tell every page what is being done; "" of nothing any more."""
        await self.tell_all(lambda page: page.working(says), None)
