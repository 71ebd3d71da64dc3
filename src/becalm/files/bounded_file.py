"""A file object for libraries that trust the sizes a file claims: it reads no more than there is."""

from __future__ import annotations

import io
import os
from typing import BinaryIO

_AGAIN = 64  # as often as its own size may a file be read: libraries go back to look for the next whole part
_ALWAYS = 1 << 24  # bytes that may be read whatever the size
_CALL = 64  # bytes that a reading of nothing counts as


class WatchedFile:
    """Gives at most what is there, ends if it is read over and over, and knows if something was cut off.

    Parameters
    ----------
    file : binary file
        Open, at its start.

    Attributes
    ----------
    size : int
        In bytes; what is made smaller ends there.
    cut : bool
        Whether a reading came to the end of the file before it had all it asked for.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.size = file.seek(0, os.SEEK_END)
        file.seek(0)
        self._left = _AGAIN * self.size + _ALWAYS
        self.cut = False

    def read(self, count: int = -1) -> bytes:
        """Read up to `count` bytes, all by default."""
        there = max(0, self.size - self._file.tell())
        data = self._file.read(there if count < 0 else min(count, there)) if self._left > 0 else b""
        self._left -= len(data) + _CALL
        self.cut = self.cut or 0 < len(data) < count
        return data

    def seek(self, place: int, whence: int = os.SEEK_SET) -> int:
        """Go elsewhere; a place before the start is the end, so that reading ends."""
        if whence == os.SEEK_CUR:
            place += self._file.tell()
        elif whence == os.SEEK_END:
            place += self.size
        return self._file.seek(place if 0 <= place <= self.size else self.size)

    def tell(self) -> int:
        """Return the place."""
        return self._file.tell()

    def close(self) -> None:
        """Close it."""
        self._file.close()


def watched(data: bytes) -> WatchedFile:
    """Watch bytes in memory."""
    return WatchedFile(io.BytesIO(data))
