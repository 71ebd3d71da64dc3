"""Which file it was: its hash."""

from __future__ import annotations

import hashlib
from pathlib import Path

from becalm.errors import InputError


def sha256(path: str | Path) -> str:
    """Return the SHA-256 of a file's bytes, as hexadecimal digits.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as cause:
        raise InputError(f"{path} cannot be read: {cause.strerror}.") from cause
