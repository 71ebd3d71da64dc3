"""Lock an output folder, so that one job at a time writes to it."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from becalm.errors import OutputError
from becalm.live.locking import locked


@contextmanager
def alone_at(folder: Path, lock: Path) -> Iterator[None]:
    """Keep other jobs from a folder while this one is at it.

    Parameters
    ----------
    folder : Path
        Which it is, for messages.
    lock : Path
        An empty file, which is made, and stays.

    Raises
    ------
    UsageError
        If another job is at it.
    OutputError
        If the file cannot be made, or its disk knows no locks.
    """
    try:
        held = locked(lock, f"Another job is at work on {folder}; wait for it, or name another with -o.")
    except sqlite3.Error as cause:
        raise OutputError(f"{lock} cannot be locked ({cause}); choose another folder with -o.") from cause
    with closing(held):
        yield
