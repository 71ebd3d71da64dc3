"""Keep a list of the temporary files of this process, so that they are removed even if it ends early."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_waiting: set[Path] = set()


@contextmanager
def removed_afterwards(path: Path) -> Iterator[None]:
    """Register a temporary file or folder; at the end, remove it if it still has this name."""
    _waiting.add(path)
    try:
        yield
    finally:
        _remove(path)
        _waiting.discard(path)


def abandon() -> None:
    """Remove all registered temporary files, for a process that ends at once."""
    for path in tuple(_waiting):
        _remove(path)


def _remove(path: Path) -> None:
    try:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    except OSError:  # the folder is missing or not writable, so the file was never created
        return
