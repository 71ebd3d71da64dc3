"""What a commit does beside keeping rows: files that were rolled are recorded, old ones given up."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterable
from contextlib import closing, suppress
from pathlib import Path

from becalm.live.block import Loss, LossKind
from becalm.live.journal.checking import told
from becalm.live.journal.database import NAME, connect, get, put, rolled_blocks, transaction, writing
from becalm.live.journal.records import LossRow, RollRow
from becalm.live.journal.rolling import Rolled

_REMOVED = """DELETE FROM blocks WHERE number IN
    (SELECT number FROM blocks WHERE number <= ? ORDER BY number LIMIT ?)"""


def record(connection: sqlite3.Connection, done: Iterable[Rolled]) -> None:
    """Record files within a transaction: from now on their blocks count no more."""
    for rolled in done:
        (last,) = connection.execute("SELECT max(number) FROM rolls").fetchone()
        put(connection, rolled.row._replace(number=(last or 0) + 1))
        for hole in rolled.holes:
            put(connection, hole)
            says = f"{told((hole.first_row, hole.end_row)).capitalize()} were kept and could not be read again."
            put(connection, LossRow.of(hole.first_row, Loss(LossKind.STORAGE, hole.end_row - hole.first_row, says)))


def remove_rolled(connection: sqlite3.Connection, most: int) -> None:
    """Remove some of the blocks that count no more, within a transaction; their pages are used again."""
    connection.execute(_REMOVED, (rolled_blocks(connection), most))


def give_up(connection: sqlite3.Connection, age_s: float) -> list[RollRow]:
    """Record within a transaction that files with nothing younger are removed, and return them.

    What happened to their rows is forgotten with them.
    """
    now = time.time()
    old = []
    for roll in get(connection, RollRow, "WHERE pruned_s IS NULL ORDER BY number"):
        last_s = roll.last_s if roll.dated and roll.last_s is not None else roll.rolled_s
        if last_s >= now - age_s:
            break  # the first of the stream's rows go first, so that those that are left have no hole
        put(connection, roll._replace(pruned_s=now))
        old.append(roll)
    if old:
        connection.execute("DELETE FROM losses WHERE row < ?", (old[-1].end_row,))
    return old


def prune(folder: Path, age_s: float) -> list[RollRow]:
    """Remove files with nothing younger, and return what was recorded of them; the stream may go on meanwhile.

    Parameters
    ----------
    folder : Path
        Of the journal.
    age_s : float
        Seconds: of stamps that are dates, else since the file was written.

    Raises
    ------
    JournalError
        If the journal cannot be read.
    StorageFullError
        If it cannot be written.
    """
    with writing(folder), closing(connect(folder / NAME)) as connection:
        with transaction(connection, folder):
            old = give_up(connection, age_s)
        remove(folder, old)
    return old


def remove(folder: Path, rolls: Iterable[RollRow]) -> None:
    """Remove files, and the folders of days that are empty then."""
    for roll in rolls:
        path = folder / roll.path
        with suppress(OSError):
            path.unlink(missing_ok=True)
            path.parent.rmdir()


def remove_leftovers(connection: sqlite3.Connection, folder: Path) -> None:
    """Remove what a process that was killed left: files half-written, or given up and not yet removed."""
    for path in folder.glob("*/.*.parquet.*.part"):
        path.unlink(missing_ok=True)
    remove(folder, get(connection, RollRow, "WHERE pruned_s IS NOT NULL"))
