"""Whether a journal is what was written: the database, its rows' seals, rows one after the other, the files."""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path

from becalm.live.journal.database import NAME, BrokenSealError, JournalError, rolled_blocks, unsealed
from becalm.live.journal.mark import MarkFile
from becalm.live.journal.reading import open_journal
from becalm.live.journal.records import TABLES, BlockRow, RollRow

Span = tuple[int, int]

_KEPT = "SELECT number, first_row, end_row FROM blocks WHERE number > ? ORDER BY number"


def database_faults(connection: sqlite3.Connection) -> Iterator[str]:
    """Say what is wrong in the database, a sentence each; all that is unrolled is read.

    Parameters
    ----------
    connection : sqlite3.Connection
        That no one else uses; the database is read as it is at one moment.
    """
    try:
        connection.execute("BEGIN")
        for (found,) in connection.execute("PRAGMA quick_check(5)"):
            if found != "ok":
                yield " ".join(str(found).split())
        broken = [sentence for table in TABLES.values() for sentence in _broken_seals(connection, table)]
        yield from broken or _jumps(connection)  # which needs rows that are what was written
    except (sqlite3.Error, BrokenSealError) as cause:
        yield str(cause)
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")


def faults(folder: Path) -> Iterator[str]:
    """Say what is wrong in a journal and its files, a sentence each; its stream may go on meanwhile.

    Raises
    ------
    JournalError
        If there is none.
    """
    mark = MarkFile(folder).read()  # first: the stream goes on
    try:
        opened = open_journal(folder)
    except JournalError as cause:
        if type(cause.__cause__) is not sqlite3.DatabaseError:  # as where there is none, or it may not be read
            raise
        yield _damaged(str(cause.__cause__))
        return
    with opened as journal:
        wrong = list(database_faults(journal.connection))
        if wrong:  # then nothing is to be asked of it
            yield from map(_damaged, wrong)
            return
        checkpoint = journal.checkpoint()
        kept = 0 if checkpoint is None else checkpoint.rows
        if mark is not None and mark.checkpoint.rows > kept:
            yield f"{told((kept, mark.checkpoint.rows)).capitalize()} were kept, and are gone from {NAME}."
        yield from file_faults(folder, journal.rolls())


def _damaged(fault: str) -> str:
    return f"{NAME} is damaged ({fault.rstrip('.')})."


def file_faults(folder: Path, rolls: Iterable[RollRow]) -> Iterator[str]:
    """Say which files are not what was written, a sentence each; all of them are read."""
    for roll in rolls:
        path = folder / roll.path
        if roll.pruned_s is not None:
            continue
        try:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as cause:
            yield f"{roll.path}, which holds {told((roll.first_row, roll.end_row))}, cannot be read: {cause.strerror}."
            continue
        if digest != roll.sha256:
            yield f"{roll.path}, which holds {told((roll.first_row, roll.end_row))}, is not what was written."


def uncovered(gap: Span, spans: Iterable[Span]) -> list[Span]:
    """Return the parts of a gap in rows that no span covers."""
    first, end = gap
    left = []
    for start, stop in sorted(spans):
        if start >= end or stop <= first:
            continue
        if start > first:
            left.append((first, start))
        first = max(first, stop)
    return [*left, (first, end)] if first < end else left


def told(rows: Span) -> str:
    """Name rows as a person does, the last included."""
    first, end = rows
    return f"row {first}" if end == first + 1 else f"rows {first} to {end - 1}"


def _broken_seals(connection: sqlite3.Connection, table: str) -> Iterator[str]:
    kind = next(kind for kind, name in TABLES.items() if name == table)
    after = f" WHERE number > {rolled_blocks(connection)}" if kind is BlockRow else ""
    for row in connection.execute(f"SELECT * FROM {table}{after}"):
        try:
            unsealed(kind, row)
        except BrokenSealError as cause:
            yield f"{str(cause).capitalize()}."


def _jumps(connection: sqlite3.Connection) -> Iterator[str]:
    """Say where rows are missing, or twice, that no hole tells of."""
    holes = list(connection.execute("SELECT first_row, end_row FROM holes"))
    expected = 0
    for path, first_row, end_row, rows in connection.execute(
        "SELECT path, first_row, end_row, rows FROM rolls ORDER BY number"
    ):
        yield from _jump(expected, first_row, holes, path)
        within = end_row - first_row - sum(b - a for a, b in uncovered((first_row, end_row), holes))
        if rows + within != end_row - first_row:
            yield f"{path} is recorded with {rows} rows of {end_row - first_row}, and {within} are known to be lost."
        expected = end_row
    number = rolled_blocks(connection)
    for block, first_row, end_row in connection.execute(_KEPT, (number,)):
        if block != number + 1:
            yield f"Block {block} follows block {number}."
        yield from _jump(expected, first_row, holes, f"block {block}")
        number, expected = block, end_row


def _jump(expected: int, first_row: int, holes: list[Span], where: str) -> Iterator[str]:
    if first_row < expected:
        yield f"{told((first_row, expected)).capitalize()} are there twice, before and in {where}."
    for gap in uncovered((expected, first_row), holes) if first_row > expected else []:
        yield f"{told(gap).capitalize()} are missing before {where}."
