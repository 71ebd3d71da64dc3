"""Files that a page sends: into a private folder, whole or not at all."""

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
"""How long each part of a file is waited for."""

_OVER_ALL = 2  # times the limit of one file
_LONGEST_NAME = 255  # bytes, of most file systems
_MEBIBYTE = 1 << 20


class RefusedError(BecalmError):
    """What a page asked for is not given; the status is that of the answer."""

    def __init__(self, says: str, status: int) -> None:
        super().__init__(says)
        self.status = status


class Uploads:
    """The files that pages sent; they go when becalm ends.

    Parameters
    ----------
    limit_bytes : int
        How large a file may be; all of them may be twice as large together.
    """

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        self._bytes = 0  # of all of them, also of those that are on their way

    @cached_property
    def folder(self) -> Path:
        """Where they are, made with the first: only its owner may enter."""
        return Path(tempfile.mkdtemp(prefix="becalm-"))

    async def take(self, request: Request, name: str) -> Path:
        """Keep the body of a request as a file of that name, in a folder of its own.

        Raises
        ------
        RefusedError
            If the name is no plain file name, the file is too large, there is no room for it, or it does not come.
        ClientDisconnect
            If the page is gone before all of it was here.

        Whatever is raised, nothing of the file is left.
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
            says = f"{name} cannot be kept ({cause.strerror}); make room where temporary files are, or set TMPDIR."
            raise RefusedError(says, 507) from cause
        return folder / name

    def close(self) -> None:
        """Remove all of them; harmless twice."""
        if "folder" in self.__dict__:  # it was made
            shutil.rmtree(self.folder, ignore_errors=True)

    def _new_folder(self) -> Path:
        folder = self.folder / secrets.token_hex(8)
        folder.mkdir(mode=0o700)
        return folder

    async def _write(self, path: Path, stream: AsyncIterator[bytes]) -> None:
        size, waiting = 0, bytearray()
        try:
            with path.open("xb") as file:
                while (part := await _soon(stream, path.name)) is not None:
                    self._check_fits(path.name, len(part), size)
                    size += len(part)
                    self._bytes += len(part)
                    waiting += part
                    if len(waiting) >= _MEBIBYTE:  # the wire of other pages does not wait for the disk
                        await run_in_threadpool(file.write, bytes(waiting))
                        waiting.clear()
                file.write(waiting)
        except BaseException:
            self._bytes -= size
            raise

    def _check_fits(self, name: str, more: int, size: int) -> None:
        """Raise a RefusedError if so many more bytes of a file of which some are here are too many."""
        if size + more > self.limit_bytes:
            most = f"{self.limit_bytes / 1e6:.6g} MB"
            raise RefusedError(f"{name} is larger than {most}; type: becalm app {name}, or raise --upload-limit.", 413)
        if self._bytes + more > (over_all := _OVER_ALL * self.limit_bytes):
            says = f"{name} does not fit: all that is dropped here may be {over_all / 1e6:.6g} MB together"
            raise RefusedError(f"{says}; end becalm and type: becalm app {name}, or raise --upload-limit.", 413)


async def _soon(stream: AsyncIterator[bytes], name: str) -> bytes | None:
    """Return the next part of a file, None at its end."""
    try:
        async with asyncio.timeout(PATIENCE_S):
            return await anext(stream, None)
    except TimeoutError as cause:
        raise RefusedError(f"Nothing of {name} came for {PATIENCE_S:g} s; drop it once more.", 408) from cause


def checked_name(name: str) -> str:
    """Return a plain file name as it came.

    Raises
    ------
    RefusedError
        If it leads elsewhere, or is none.
    """
    odd = any(unicodedata.category(letter) in ("Cc", "Cs") or letter in "/\\" for letter in name)
    drive = os.name == "nt" and ":" in name
    if odd or drive or name in ("", ".", "..") or len(name.encode("utf-8", "replace")) > _LONGEST_NAME:
        shown = ascii(name if len(name) <= 80 else f"{name[:80]}...")
        raise RefusedError(f"{shown} is no file name; a name without folders is needed.", 400)
    return name
