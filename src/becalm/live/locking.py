"""Lock a folder for one process; the lock is released however the process ends."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from becalm.errors import UsageError


def lock_file(path: Path, refusal: str) -> sqlite3.Connection:
    """Lock a file against other processes; return the connection that holds the lock until it is closed.

    Parameters
    ----------
    path : Path
        Empty lock file, created if absent. SQLite locks it on every system.
    refusal : str
        Error message if another process holds the lock.

    Raises
    ------
    UsageError
        If another process holds the lock.
    sqlite3.Error
        If the file cannot be created.
    """
    connection = sqlite3.connect(path, timeout=0, isolation_level=None, check_same_thread=False)
    try:
        connection.execute("BEGIN EXCLUSIVE")
    except BaseException as cause:
        connection.close()
        if isinstance(cause, sqlite3.OperationalError) and cause.sqlite_errorcode == sqlite3.SQLITE_BUSY:
            raise UsageError(refusal) from cause
        raise
    return connection
