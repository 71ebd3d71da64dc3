"""The first page of a journal's database, the same in all of them but for a size: damage there takes nothing along."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing, suppress
from pathlib import Path

from becalm.live.journal.database import PAGE, create

_SIZE = slice(28, 32)  # in pages, big end first
_WAL = slice(18, 20)  # 2: there is a log beside


def is_sound(connection: sqlite3.Connection) -> bool:
    """Whether a database's first page tells where the tables of a journal are."""
    with closing(_fresh()) as fresh:
        expected = _tables(fresh)
    with suppress(sqlite3.Error):
        return _tables(connection) == expected
    return False


def with_first_page(path: Path, copy: Path) -> None:
    """Copy a database, with its log, and give the copy a sound first page.

    Raises
    ------
    OSError
        If there is no room.
    """
    shutil.copyfile(path, copy)
    with suppress(FileNotFoundError):
        shutil.copyfile(f"{path}-wal", f"{copy}-wal")
    with closing(_fresh()) as fresh:
        page = bytearray(fresh.serialize()[:PAGE])
    page[_SIZE] = (copy.stat().st_size // PAGE).to_bytes(4, "big")
    page[_WAL] = b"\2\2"
    with copy.open("r+b") as file:
        file.write(page)


def _fresh() -> sqlite3.Connection:
    fresh = sqlite3.connect(":memory:", isolation_level=None)
    create(fresh)
    return fresh


def _tables(connection: sqlite3.Connection) -> list[tuple[object, ...]]:
    return connection.execute("SELECT name, rootpage, sql FROM sqlite_master ORDER BY rootpage").fetchall()
