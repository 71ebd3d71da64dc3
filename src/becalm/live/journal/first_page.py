"""Restore the first page of a journal's database, which is the same in all journals except for the size."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing, suppress
from pathlib import Path

from becalm.live.journal.database import PAGE, create

_SIZE = slice(28, 32)  # bytes of the first page: size of the database in pages, big-endian
_WAL = slice(18, 20)  # format numbers; 2 means write-ahead logging


def is_sound(connection: sqlite3.Connection) -> bool:
    """Return whether a database's first page lists the tables of a journal correctly."""
    with closing(_empty_journal()) as empty:
        expected = _tables(empty)
    with suppress(sqlite3.Error):
        return _tables(connection) == expected
    return False


def copy_with_first_page(path: Path, copy: Path) -> None:
    """Copy a database with its write-ahead log, and replace the copy's first page with an intact one.

    Raises
    ------
    OSError
        If the copy cannot be written.
    """
    shutil.copyfile(path, copy)
    with suppress(FileNotFoundError):
        shutil.copyfile(f"{path}-wal", f"{copy}-wal")
    with closing(_empty_journal()) as empty:
        page = bytearray(empty.serialize()[:PAGE])
    page[_SIZE] = (copy.stat().st_size // PAGE).to_bytes(4, "big")
    page[_WAL] = b"\2\2"
    with copy.open("r+b") as file:
        file.write(page)


def _empty_journal() -> sqlite3.Connection:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    create(connection)
    return connection


def _tables(connection: sqlite3.Connection) -> list[tuple[object, ...]]:
    return connection.execute("SELECT name, rootpage, sql FROM sqlite_master ORDER BY rootpage").fetchall()
