"""Detect changes of a file while it is read, and compute its hash."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple

from becalm.errors import InputError
from becalm.files.decoding import explain_read_errors


class _Facts(NamedTuple):
    device: int
    inode: int
    size: int
    changed_ns: int


class Original:
    """A file as it was when reading began.

    Parameters
    ----------
    path : Path
        The file; not a pipe, because it must be possible to read it again.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._facts = path, _facts(path)

    def refuse_changed(self) -> None:
        """Refuse a file that changed since reading began: its inode, size or time of modification.

        Raises
        ------
        InputError
            If the file was replaced, written to or removed.
        """
        if _facts(self._path) != self._facts:
            raise InputError(f"{self._path} changed while it was read; wait until it is complete, and repeat.")

    def sha256(self) -> str:
        """Return the SHA-256 of the file's bytes, as hexadecimal digits.

        Raises
        ------
        InputError
            If the file cannot be read, or changed since reading began.
        """
        with explain_read_errors(self._path), self._path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256")
        self.refuse_changed()
        return digest.hexdigest()


def _facts(path: Path) -> _Facts | None:
    try:
        status = path.stat()
    except OSError:  # the file was removed, or its disk is not connected
        return None
    return _Facts(status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
