"""Files that a page sends: into a private folder, whole or not at all."""

from __future__ import annotations

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
        How large a file may be.
    """

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes

    @cached_property
    def folder(self) -> Path:
        """Where they are, made with the first: only its owner may enter."""
        return Path(tempfile.mkdtemp(prefix="becalm-"))

    async def take(self, request: Request, name: str) -> Path:
        """Keep the body of a request as a file of that name, in a folder of its own.

        Raises
        ------
        RefusedError
            If the name is no plain file name, the file is too large, or there is no room for it.
        ClientDisconnect
            If the page is gone before all of it was here.

        Whatever is raised, nothing of the file is left.
        """
        checked_name(name)
        said = request.headers.get("content-length", "0")
        if int(said) > self.limit_bytes:
            raise self._too_large(name)
        folder = self.folder / secrets.token_hex(8)
        folder.mkdir(mode=0o700)
        try:
            await self._write(folder / name, request.stream())
        except BaseException as cause:
            shutil.rmtree(folder, ignore_errors=True)
            if not isinstance(cause, OSError):
                raise
            raise RefusedError(f"{name} cannot be kept ({cause.strerror}); make room in {self.folder}.", 507) from cause
        return folder / name

    def close(self) -> None:
        """Remove all of them; harmless twice."""
        if "folder" in self.__dict__:  # it was made
            shutil.rmtree(self.folder, ignore_errors=True)

    async def _write(self, path: Path, stream: AsyncIterator[bytes]) -> None:
        size, waiting = 0, bytearray()
        with path.open("xb") as file:
            async for part in stream:
                size += len(part)
                if size > self.limit_bytes:
                    raise self._too_large(path.name)
                waiting += part
                if len(waiting) >= _MEBIBYTE:  # the wire of other pages does not wait for the disk
                    await run_in_threadpool(file.write, bytes(waiting))
                    waiting.clear()
            file.write(waiting)

    def _too_large(self, name: str) -> RefusedError:
        most = f"{self.limit_bytes / 1e6:.6g} MB"
        return RefusedError(f"{name} is larger than {most}; type: becalm app {name}, or raise --upload-limit.", 413)


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
