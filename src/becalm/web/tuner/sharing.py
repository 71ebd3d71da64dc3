"""Hold the state that all pages of a tuner share: the folder, the open recording and the threads."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol, TypeVar

from becalm.errors import BecalmError, InputError, UsageError
from becalm.files.read_options import ReadOptions
from becalm.files.registry import writable_endings
from becalm.installation import load_scipy, version
from becalm.web.tuner.folder import READ_ENDINGS, Folder
from becalm.web.tuner.opened import AS_IT_IS, OpenRecording
from becalm.web.tuner.view_model import ViewModel
from becalm.web.uploads import Uploads

_HALVES, _WORKERS = 2, 6  # threads for the two halves of a long picture, and for all other work

T = TypeVar("T")
Sender = Callable[[Any], Coroutine[Any, Any, None]]
"""A function that sends something to the page that is its argument."""


class OpenPage(Protocol):
    """The interface of an open page."""

    def start_sending(self, what: Sender) -> None:
        """Start to send the page something, and return at once."""
        ...


class Shared:
    """The state that all pages share.

    Parameters
    ----------
    folder : Path
        Folder whose files may be opened.
    file : Path or None
        File to open first.
    upload_limit : int
        Size limit of a file that a page uploads, in bytes.
    options : ReadOptions
        Options for the time base of the file to open first.
    """

    def __init__(self, folder: Path, file: Path | None, upload_limit: int, options: ReadOptions = AS_IT_IS) -> None:
        self._options = options
        self.folder = Folder(folder, file)
        self.uploads = Uploads(upload_limit)
        load_scipy()
        self.halves = ThreadPoolExecutor(_HALVES, thread_name_prefix="becalm-half")
        self.workers = ThreadPoolExecutor(_WORKERS, thread_name_prefix="becalm-tuner")
        self.pages: set[OpenPage] = set()
        self.view_model: ViewModel | None = None
        self._opening = asyncio.Lock()
        self._openings: set[asyncio.Task[None]] = set()
        self._run = secrets.token_hex(8)

    @property
    def first(self) -> str | None:
        """Return the id of the file to open first, or None."""
        return self.folder.first

    def welcome(self) -> dict[str, Any]:
        """Return the first message to a page."""
        return {
            "kind": "welcome",
            "version": version(),
            "run": self._run,
            **self.files(),
            "file": self.first if self.view_model is None else self.view_model.opened.id,
            "saves": writable_endings(),
        }

    def files(self) -> dict[str, Any]:
        """Return the part of a message that lists the files to open."""
        return {
            "folder": self.folder.name,
            "files": [one.as_dict() for one in self.folder.openable_files()],
            "upload_limit": self.uploads.limit_bytes,
            "formats": list(READ_ENDINGS),
        }

    def is_open(self, file: str, group: str | None, rate_hz: float | None) -> bool:
        """Return whether a file is open with these options, and unchanged (or deleted) since it was read."""
        if (
            self.view_model is None
            or self.view_model.opened.id != file
            or group not in (None, self.view_model.opened.group)
        ):
            return False
        if rate_hz not in (None, self.view_model.opened.read_options.rate_hz):
            return False
        try:
            path = self.folder.path_of(file)
        except InputError:  # the file was deleted, but the recording is in memory
            return True
        return self.view_model.opened.is_unchanged(path)

    async def open(self, file: str, group: str | None, rate_hz: float | None = None) -> None:
        """Open a file instead of the open file, which stays open after an error.

        Raises
        ------
        BecalmError
            If the file cannot be read, or its filters cannot be identified.
        """
        opening = asyncio.create_task(self._open(file, group, rate_hz))
        self._openings.add(opening)  # continues if the page is reloaded, because the page then requests the file again
        opening.add_done_callback(self._finish_opening)
        await asyncio.shield(opening)

    def _finish_opening(self, opening: asyncio.Task[None]) -> None:
        self._openings.discard(opening)
        if not opening.cancelled():
            opening.exception()  # marks the exception as seen, so that asyncio does not log it

    async def _open(self, file: str, group: str | None, rate_hz: float | None) -> None:
        async with self._opening:
            if self.is_open(file, group, rate_hz):
                return  # another page has opened it meanwhile
            options = self._options if file == self.first else AS_IT_IS
            if rate_hz is not None:
                options = ReadOptions(rate_hz=rate_hz)
            path, loop = self.folder.path_of(file), asyncio.get_running_loop()

            def report(says: str) -> None:
                asyncio.run_coroutine_threadsafe(self.send_progress(says), loop)

            def begin() -> ViewModel:
                try:
                    view_model = ViewModel(OpenRecording(file, path, group, report, options))
                    view_model.begin()
                except BecalmError as cause:  # a page shows names without paths, and has a field for the rate
                    message = str(cause).replace(str(path), path.name).replace("--rate HZ", "the rate (Hz) below")
                    raise type(cause)(message) from cause
                return view_model

            try:
                self.view_model = await loop.run_in_executor(self.workers, begin)
            except BaseException:
                await self.send_progress("")
                raise

    async def broadcast(self, what: Sender, asker: OpenPage | None) -> None:
        """Send something to every page; wait only for the page `asker`, which requested it."""
        for page in tuple(self.pages):
            if page is not asker:
                page.start_sending(what)
        if asker is not None:
            await what(asker)

    async def in_thread(self, work: Callable[[], T]) -> T:
        """Run some work in a thread."""
        return await asyncio.get_running_loop().run_in_executor(self.workers, work)

    @property
    def current_view_model(self) -> ViewModel:
        """Return the view model of the open recording.

        Raises
        ------
        UsageError
            If nothing is open.
        """
        if self.view_model is None:
            raise UsageError("Nothing is open yet; choose a file, or drop one here.")
        return self.view_model

    def close(self) -> None:
        """Stop the threads, and remove uploaded files."""
        for pool in (self.workers, self.halves):
            pool.shutdown(wait=False, cancel_futures=True)
        self.uploads.close()

    async def send_progress(self, says: str) -> None:
        """Send every page a sentence on the work in progress; "" if it is finished."""
        await self.broadcast(lambda page: page.send_progress(says), None)
