"""Keep a list of the temporary files of this process, so that they are removed whatever happens."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_waiting: set[Path] = set()


@contextmanager
def in_waiting(path: Path) -> Iterator[None]:
    """Keep in mind that a file, or a folder, is half-written; in the end it is removed, if it still has this name."""
    _waiting.add(path)
    try:
        yield
    finally:
        _remove(path)
        _waiting.discard(path)


def abandon() -> None:
    """Remove all that is half-written, for a process that ends at once."""
    for path in tuple(_waiting):
        _remove(path)


def _remove(path: Path) -> None:
    try:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    except OSError:  # the folder is not writable or not there: then nothing was made
        return
