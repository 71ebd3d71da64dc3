"""Record the Parquet files of a journal, remove their blocks from the database, and remove old files."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterable
from contextlib import closing, suppress
from pathlib import Path

from becalm.live.block import Loss, LossKind
from becalm.live.journal.checking import rows_text
from becalm.live.journal.database import NAME, connect, get, last_rolled_block, put, transaction, writing
from becalm.live.journal.records import LossRow, RollRow
from becalm.live.journal.rolling import Rolled

_REMOVED = """DELETE FROM blocks WHERE number IN
    (SELECT number FROM blocks WHERE number <= ? ORDER BY number LIMIT ?)"""


def record(connection: sqlite3.Connection, done: Iterable[Rolled]) -> None:
    """Record files within a transaction; their blocks are no longer used.

    A file that is recorded already, by a transaction that seemed to fail, is passed over.
    """
    recorded = last_rolled_block(connection)
    for rolled in done:
        if rolled.row.last_block <= recorded:
            continue
        (last,) = connection.execute("SELECT max(number) FROM rolls").fetchone()
        put(connection, rolled.row._replace(number=(last or 0) + 1))
        for hole in rolled.holes:
            put(connection, hole)
            text = (
                f"{rows_text((hole.first_row, hole.end_row)).capitalize()} were committed and could not be read again."
            )
            put(connection, LossRow.of(hole.first_row, Loss(LossKind.STORAGE, hole.end_row - hole.first_row, text)))


def remove_rolled(connection: sqlite3.Connection, most: int) -> None:
    """Remove up to `most` blocks whose rows are in files, within a transaction; SQLite reuses their pages."""
    connection.execute(_REMOVED, (last_rolled_block(connection), most))


def record_pruned(connection: sqlite3.Connection, age_s: float) -> list[RollRow]:
    """Record within a transaction that files older than `age_s` are removed; return their records.

    The losses of their rows are removed too.
    """
    now = time.time()
    old = []
    for roll in get(connection, RollRow, "WHERE pruned_s IS NULL ORDER BY number"):
        last_s = roll.last_s if roll.dated and roll.last_s is not None else roll.rolled_s
        if last_s >= now - age_s:
            break  # only the oldest rows are removed, so that the remaining rows have no hole
        put(connection, roll._replace(pruned_s=now))
        old.append(roll)
    if old:
        connection.execute("DELETE FROM losses WHERE row < ?", (old[-1].end_row,))
    return old


def prune(folder: Path, age_s: float) -> list[RollRow]:
    """Remove old files and return their records; the stream may continue meanwhile.

    Parameters
    ----------
    folder : Path
        Folder of the journal.
    age_s : float
        Age in seconds, by the last stamp if stamps are dates, else by the time when the file was written.

    Raises
    ------
    JournalError
        If the journal cannot be read.
    StorageFullError
        If the journal cannot be written.
    """
    with writing(folder), closing(connect(folder / NAME)) as connection:
        with transaction(connection, folder):
            old = record_pruned(connection, age_s)
        remove(folder, old)
    return old


def remove(folder: Path, rolls: Iterable[RollRow]) -> None:
    """Remove files, and the folders of their days if they are empty."""
    for roll in rolls:
        path = folder / roll.path
        with suppress(OSError):
            path.unlink(missing_ok=True)
            path.parent.rmdir()


def remove_leftovers(connection: sqlite3.Connection, folder: Path) -> None:
    """Remove files that a killed process left: half-written ones, and old ones that are recorded as removed."""
    for path in folder.glob("*/.*.parquet.*.part"):
        path.unlink(missing_ok=True)
    remove(folder, get(connection, RollRow, "WHERE pruned_s IS NOT NULL"))
