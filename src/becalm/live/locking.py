"""One writer at a time: a lock that goes with its process, however that ends."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from becalm.errors import UsageError


def locked(path: Path, refusal: str) -> sqlite3.Connection:
    """Keep other processes from where a file lies, until the connection is closed or the process ends.

    Parameters
    ----------
    path : Path
        An empty file, which is made; SQLite locks it on every system.
    refusal : str
        What to say where another one has it.

    Raises
    ------
    UsageError
        If another one has it.
    sqlite3.Error
        If the file cannot be made.
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
