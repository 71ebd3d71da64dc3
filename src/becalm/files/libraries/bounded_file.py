"""A file object that limits what a library can read when a damaged file states sizes that are too large."""

from __future__ import annotations

import io
import os
from typing import BinaryIO

_MOST_PASSES = 64  # most bytes read per byte of the file; a library may reread bytes to find the next intact part
_ALWAYS = 1 << 24  # bytes that may be read in addition, for a file of any size
_CALL = 64  # bytes that each call of `read` adds to the total, so that the limit also ends a loop of empty reads


class BoundedFile:
    """A binary file that never reads past its end, limits the total number of bytes read, and detects truncation.

    Parameters
    ----------
    file : binary file
        Open, at its start.

    Attributes
    ----------
    size : int
        Bytes that can be read; assign a smaller number to end the file earlier.
    cut : bool
        Whether a call of `read` reached the end of the file and returned some bytes, but fewer than requested.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.size = file.seek(0, os.SEEK_END)
        file.seek(0)
        self._left = _MOST_PASSES * self.size + _ALWAYS
        self.cut = False

    def read(self, count: int = -1) -> bytes:
        """Read up to `count` bytes, all by default; return b"" once the total limit is used up."""
        available = max(0, self.size - self._file.tell())
        data = self._file.read(available if count < 0 else min(count, available)) if self._left > 0 else b""
        self._left -= len(data) + _CALL
        self.cut = self.cut or 0 < len(data) < count
        return data

    def seek(self, place: int, whence: int = os.SEEK_SET) -> int:
        """Move to a position in bytes; a position outside the file becomes the end, so that reading stops."""
        if whence == os.SEEK_CUR:
            place += self._file.tell()
        elif whence == os.SEEK_END:
            place += self.size
        return self._file.seek(place if 0 <= place <= self.size else self.size)

    def tell(self) -> int:
        """Return the position in bytes."""
        return self._file.tell()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def bounded_bytes(data: bytes) -> BoundedFile:
    """Return a BoundedFile that reads bytes in memory."""
    return BoundedFile(io.BytesIO(data))
