"""Create, open, write and read the journal's SQLite file; one process can read while another writes."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote

from becalm.errors import InputError
from becalm.live.journal.records import TABLES, seal
from becalm.live.protocols import StorageFullError

NAME = "journal.sqlite"
VERSION = 1  # of the table layout
PAGE = 8192  # page size in bytes

_APPLICATION = 0x6265636C  # "becl"
_WAL_PAGES = 2048  # pages in the write-ahead log (16 MiB) after which a commit moves them into the database
_WAIT_S = 30.0  # seconds to wait for another writer, such as `becalm journal DIR prune`

_SCHEMA = """
CREATE TABLE heads (number INTEGER PRIMARY KEY, names TEXT, units TEXT, rate_hz REAL, recipe TEXT, seal BLOB);
CREATE TABLE blocks (number INTEGER PRIMARY KEY, head INTEGER, first_row INTEGER, end_row INTEGER, first_s REAL,
    last_s REAL, kept_s REAL, period_s INTEGER, dated INTEGER, position TEXT, source TEXT, snapshot BLOB, data BLOB,
    seal BLOB);
CREATE TABLE rolls (number INTEGER PRIMARY KEY, path TEXT, head INTEGER, last_block INTEGER, first_row INTEGER,
    end_row INTEGER, rows INTEGER, first_s REAL, last_s REAL, dated INTEGER, rolled_s REAL, size INTEGER, sha256 TEXT,
    pruned_s REAL, seal BLOB);
CREATE TABLE losses (number INTEGER PRIMARY KEY, row INTEGER, kind TEXT, rows INTEGER, says TEXT, noticed_s REAL,
    seal BLOB);
CREATE TABLE holes (number INTEGER PRIMARY KEY, first_row INTEGER, end_row INTEGER, seal BLOB);
"""

Row = TypeVar("Row", bound=tuple[Any, ...])


class JournalError(InputError):
    """A journal cannot be read, or its stream cannot continue."""


class NewerJournalError(JournalError):
    """A journal that a newer becalm wrote."""


class BrokenSealError(Exception):
    """A database row differs from what was written."""


def connect(path: Path) -> sqlite3.Connection:
    """Open a journal's database for writing; create it if absent. One thread at a time may use the connection.

    Raises
    ------
    sqlite3.Error
        If it cannot be opened or created.
    JournalError
        If it is a database of another program, or of a newer becalm.
    """
    connection = sqlite3.connect(path, timeout=_WAIT_S, isolation_level=None, check_same_thread=False)
    try:
        connection.execute(f"PRAGMA page_size = {PAGE}")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute(f"PRAGMA wal_autocheckpoint = {_WAL_PAGES}")
        connection.execute(f"PRAGMA journal_size_limit = {2 * _WAL_PAGES * PAGE}")
        if not connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            create(connection)
        _refuse_others(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


def create(connection: sqlite3.Connection) -> None:
    """Create the tables of a journal in an empty database."""
    head = f"PRAGMA application_id = {_APPLICATION}; PRAGMA user_version = {VERSION};"
    connection.executescript(f"PRAGMA page_size = {PAGE}; BEGIN IMMEDIATE; {head} {_SCHEMA} COMMIT;")


def connect_reading(path: Path) -> sqlite3.Connection:
    """Open a journal's database read-only, while another process may write; raises the errors of `connect`."""
    name = quote(str(path.resolve()))
    connection = sqlite3.connect(
        f"file:{name}?mode=ro", uri=True, timeout=_WAIT_S, isolation_level=None, check_same_thread=False
    )
    try:
        _refuse_others(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


@contextmanager
def transaction(connection: sqlite3.Connection, folder: Path) -> Iterator[None]:
    """Commit everything that is written in the `with` block, or nothing.

    Raises
    ------
    StorageFullError
        If the disk is full or cannot be written.
    JournalError
        If the database is damaged.
    """
    with writing(folder):
        connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            connection.execute("COMMIT")
        except BaseException:
            with suppress(sqlite3.Error):
                connection.execute("ROLLBACK")
            raise


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turn SQLite's errors while writing a journal into messages for the user.

    Raises
    ------
    StorageFullError
        If the disk is full or cannot be written.
    JournalError
        If the database is damaged.
    """
    try:
        yield
    except (sqlite3.OperationalError, OSError) as cause:
        raise StorageFullError(
            f"The journal in {folder} cannot be written ({cause}); nothing was half-written. Free disk space or check"
            " the permissions there."
        ) from cause
    except (sqlite3.DatabaseError, BrokenSealError) as cause:
        raise JournalError(
            f"{folder / NAME} is damaged ({cause}); start the stream again, which recovers the rows that can be read."
        ) from cause


@contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Turn SQLite's errors while reading a journal into a message for the user.

    Raises
    ------
    JournalError
        If SQLite raises an error, or a row is damaged.
    """
    try:
        yield
    except (sqlite3.Error, BrokenSealError) as cause:
        raise JournalError(
            f"{folder / NAME} cannot be read ({cause}). Type `becalm journal {folder} verify` to see what is wrong;"
            " the next start of its stream recovers the rows that can be read."
        ) from cause


def put(connection: sqlite3.Connection, row: tuple[Any, ...]) -> None:
    """Write a row into its table, replacing a row with the same number; a row without a number gets the next number."""
    marks = ", ".join("?" * (len(row) + 1))
    number = row[0]
    if number is None:
        (last,) = connection.execute(f"SELECT max(number) FROM {TABLES[type(row)]}").fetchone()
        number = (last or 0) + 1
    values = (number, *row[1:])
    connection.execute(f"INSERT OR REPLACE INTO {TABLES[type(row)]} VALUES ({marks})", (*values, seal(values)))


def get(connection: sqlite3.Connection, kind: type[Row], tail: str = "", values: Sequence[object] = ()) -> list[Row]:
    """Return all rows of a table in order of number, or the rows that `tail` (WHERE, ...) with its `values` selects.

    Raises
    ------
    BrokenSealError
        If a row differs from what was written.
    sqlite3.Error
        If the file cannot be read.
    """
    rows = connection.execute(f"SELECT * FROM {TABLES[kind]} {tail or 'ORDER BY number'}", values).fetchall()
    return [unseal(kind, row) for row in rows]


def unseal(kind: type[Row], row: tuple[Any, ...]) -> Row:
    """Check the seal of a row; return the row without the seal.

    Raises
    ------
    BrokenSealError
        If the row differs from what was written.
    """
    if seal(row[:-1]) != row[-1]:
        raise BrokenSealError(f"row {row[0]} of {TABLES[kind]} differs from what was written")
    return kind(*row[:-1])


def last_rolled_block(connection: sqlite3.Connection) -> int:
    """Return the number of the last block whose rows are in a Parquet file, or 0; blocks up to it are no longer used.

    Raises
    ------
    BrokenSealError
        If the stored number is not an integer.
    """
    record = connection.execute("SELECT last_block FROM rolls ORDER BY number DESC LIMIT 1").fetchone()
    last = 0 if record is None else record[0]
    if not isinstance(last, int):  # a damaged row may hold any value
        raise BrokenSealError("the record of the last file differs from what was written")
    return last


def _refuse_others(connection: sqlite3.Connection, path: Path) -> None:
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if tables and application != _APPLICATION:
        raise JournalError(f"{path} is a database of another program; give the journal another folder.")
    if version > VERSION:
        raise NewerJournalError(f"{path} is of a newer becalm; update becalm, or give the journal another folder.")
