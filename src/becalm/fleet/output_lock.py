"""Lock an output folder, so that one job at a time writes to it."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from becalm.errors import OutputError
from becalm.live.locking import lock_file


@contextmanager
def lock_output(folder: Path, lock: Path) -> Iterator[None]:
    """Lock a folder for one job, in a `with`.

    Parameters
    ----------
    folder : Path
        The folder, for messages.
    lock : Path
        The lock file, which is empty. It is created if it is missing, and is not removed.

    Raises
    ------
    UsageError
        If another job has locked the folder.
    OutputError
        If the lock file cannot be created, or its file system does not support locks.
    """
    try:
        held = lock_file(lock, f"Another job is at work on {folder}; wait for it, or name another folder with -o.")
    except sqlite3.Error as cause:
        raise OutputError(f"{lock} cannot be locked ({cause}); choose another folder with -o.") from cause
    with closing(held):
        yield
