"""Which file it was: whether it is still the same, and its hash."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple

from becalm.errors import InputError
from becalm.files.decoding import told


class _Facts(NamedTuple):
    device: int
    inode: int
    size: int
    changed_ns: int


class Original:
    """A file as it was when reading began; only of one that can be read again, so of no pipe.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._facts = path, _facts(path)

    def refuse_changed(self) -> None:
        """Compare the file with what it was.

        Raises
        ------
        InputError
            If it was replaced, written to or removed.
        """
        if _facts(self._path) != self._facts:
            raise InputError(f"{self._path} changed while it was read; wait until it is complete, and repeat.")

    def sha256(self) -> str:
        """Return the SHA-256 of the file's bytes, as hexadecimal digits.

        Raises
        ------
        InputError
            If the file cannot be read, or is not what it was.
        """
        with told(self._path), self._path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256")
        self.refuse_changed()
        return digest.hexdigest()


def _facts(path: Path) -> _Facts | None:
    try:
        found = path.stat()
    except OSError:  # it is gone, or out of reach
        return None
    return _Facts(found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns)
