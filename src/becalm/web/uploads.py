"""Store the files that a page sends in a private folder, completely or not at all."""

from __future__ import annotations

import asyncio
import os
import secrets
import shutil
import tempfile
import unicodedata
from collections.abc import AsyncIterator
from functools import cached_property
from pathlib import Path

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from becalm.errors import BecalmError

PATIENCE_S = 60.0
"""Time limit for the arrival of each part of a file."""

_OVER_ALL = 2  # size limit of all files together, as a multiple of the limit of one file
_LONGEST_NAME = 255  # bytes of a file name, the limit of most file systems
_MEBIBYTE = 1 << 20


class RefusedError(BecalmError):
    """A request of a page was refused; `status` is the HTTP status of the response."""

    def __init__(self, says: str, status: int) -> None:
        super().__init__(says)
        self.status = status


class Uploads:
    """The files that pages sent; they are removed when becalm ends.

    Parameters
    ----------
    limit_bytes : int
        Size limit of one file, in bytes; all files together may have twice as much.
    """

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        self._bytes = 0  # of all files, including unfinished ones

    @cached_property
    def folder(self) -> Path:
        """Return the folder of the files; it is created at the first call, and only its owner may enter it."""
        return Path(tempfile.mkdtemp(prefix="becalm-"))

    async def store(self, request: Request, name: str) -> Path:
        """Store the body of a request as a file with this name, in a new folder; return its path.

        After an exception, no part of the file remains.

        Raises
        ------
        RefusedError
            If the name is not a plain file name, the file is too large, the disk is full, or no data arrive in time.
        ClientDisconnect
            If the page disconnects before the file is complete.
        """
        checked_name(name)
        self._check_fits(name, int(request.headers.get("content-length", "0")), 0)
        folder: Path | None = None
        try:
            folder = self._new_folder()
            await self._write(folder / name, request.stream())
        except BaseException as cause:
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)
            if not isinstance(cause, OSError):
                raise
            says = f"{name} cannot be stored ({cause.strerror}); free space for temporary files, or set TMPDIR."
            raise RefusedError(says, 507) from cause
        return folder / name

    def close(self) -> None:
        """Remove all files; a second call does nothing."""
        if "folder" in self.__dict__:  # the folder exists
            shutil.rmtree(self.folder, ignore_errors=True)

    def _new_folder(self) -> Path:
        folder = self.folder / secrets.token_hex(8)
        folder.mkdir(mode=0o700)
        return folder

    async def _write(self, path: Path, stream: AsyncIterator[bytes]) -> None:
        size, waiting = 0, bytearray()
        try:
            with path.open("xb") as file:
                while (part := await _next_part(stream, path.name)) is not None:
                    self._check_fits(path.name, len(part), size)
                    size += len(part)
                    self._bytes += len(part)
                    waiting += part
                    if len(waiting) >= _MEBIBYTE:  # written in a thread: other pages do not wait
                        await run_in_threadpool(file.write, bytes(waiting))
                        waiting.clear()
                file.write(waiting)
        except BaseException:
            self._bytes -= size
            raise

    def _check_fits(self, name: str, more: int, size: int) -> None:
        """Raise a RefusedError if `more` bytes are too many for a file that has `size` bytes already."""
        if size + more > self.limit_bytes:
            most = f"{self.limit_bytes / 1e6:.6g} MB"
            raise RefusedError(f"{name} is larger than {most}; type: becalm app {name}, or raise --upload-limit.", 413)
        if self._bytes + more > (over_all := _OVER_ALL * self.limit_bytes):
            says = f"{name} does not fit: all dropped files together may have {over_all / 1e6:.6g} MB"
            raise RefusedError(f"{says}; end becalm and type: becalm app {name}, or raise --upload-limit.", 413)


async def _next_part(stream: AsyncIterator[bytes], name: str) -> bytes | None:
    """Return the next part of a file, or None at its end; raise a RefusedError if it does not arrive in time."""
    try:
        async with asyncio.timeout(PATIENCE_S):
            return await anext(stream, None)
    except TimeoutError as cause:
        raise RefusedError(f"No data of {name} arrived for {PATIENCE_S:g} s; drop it again.", 408) from cause


def checked_name(name: str) -> str:
    """Return a plain file name unchanged.

    Raises
    ------
    RefusedError
        If the name contains a folder, or is not a file name.
    """
    odd = any(unicodedata.category(letter) in ("Cc", "Cs") or letter in "/\\" for letter in name)
    drive = os.name == "nt" and ":" in name
    if odd or drive or name in ("", ".", "..") or len(name.encode("utf-8", "replace")) > _LONGEST_NAME:
        shown = ascii(name if len(name) <= 80 else f"{name[:80]}...")
        raise RefusedError(f"{shown} is not a file name; a name without folders is needed.", 400)
    return name
