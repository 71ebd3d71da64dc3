"""Lock an output folder, so that one job at a time writes to it."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from becalm.errors import OutputError
from becalm.live.locking import locked


@contextmanager
def lock_output(folder: Path, lock: Path) -> Iterator[None]:
    """Lock a folder for one job, in a `with`.

    Parameters
    ----------
    folder : Path
        The folder, for messages.
    lock : Path
        An empty file; it is created if it is missing, and stays.

    Raises
    ------
    UsageError
        If another job has locked the folder.
    OutputError
        If the file cannot be created, or its file system does not support locks.
    """
    try:
        held = locked(lock, f"Another job is at work on {folder}; wait for it, or name another folder with -o.")
    except sqlite3.Error as cause:
        raise OutputError(f"{lock} cannot be locked ({cause}); choose another folder with -o.") from cause
    with closing(held):
        yield
