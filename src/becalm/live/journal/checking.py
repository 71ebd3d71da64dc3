"""Check a journal for damage: the database, the seal of each record, gaps and repeats of rows, and the files."""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path

from becalm.live.journal.database import NAME, BrokenSealError, JournalError, last_rolled_block, unseal
from becalm.live.journal.mark import MarkFile
from becalm.live.journal.reading import open_journal
from becalm.live.journal.records import TABLES, BlockRow, RollRow

Span = tuple[int, int]
"""First row, and the row after the last."""

_BLOCKS = "SELECT number, first_row, end_row FROM blocks WHERE number > ? ORDER BY number"


def database_faults(connection: sqlite3.Connection) -> Iterator[str]:
    """Yield a sentence for each fault of the database; all blocks whose rows are not in files are read.

    Parameters
    ----------
    connection : sqlite3.Connection
        Connection for this check only; all queries run in one transaction.
    """
    try:
        connection.execute("BEGIN")
        for (result,) in connection.execute("PRAGMA quick_check(5)"):
            if result != "ok":
                yield " ".join(str(result).split())
        broken = [sentence for table in TABLES.values() for sentence in _broken_seals(connection, table)]
        yield from broken or _row_faults(connection)  # the second check needs intact rows
    except (sqlite3.Error, BrokenSealError) as cause:
        yield str(cause)
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")


def faults(folder: Path) -> Iterator[str]:
    """Yield a sentence for each fault of a journal and its files; its stream may continue meanwhile.

    Raises
    ------
    JournalError
        If the folder has no journal, or it cannot be opened for another reason than damage.
    """
    mark = MarkFile(folder).read()  # first, so that the mark is not newer than the database while the stream runs
    try:
        opened = open_journal(folder)
    except JournalError as cause:
        if type(cause.__cause__) is not sqlite3.DatabaseError:  # no journal of this becalm
            raise
        yield _damaged(str(cause.__cause__))
        return
    with opened as journal:
        wrong = list(database_faults(journal.connection))
        if wrong:  # a damaged database cannot be queried further
            yield from map(_damaged, wrong)
            return
        checkpoint = journal.checkpoint()
        kept = 0 if checkpoint is None else checkpoint.rows
        if mark is not None and mark.checkpoint.rows > kept:
            yield f"{rows_text((kept, mark.checkpoint.rows)).capitalize()} were committed, but are missing in {NAME}."
        yield from file_faults(folder, journal.rolls())


def _damaged(fault: str) -> str:
    return f"{NAME} is damaged ({fault.rstrip('.')})."


def file_faults(folder: Path, rolls: Iterable[RollRow]) -> Iterator[str]:
    """Yield a sentence for each file that cannot be read or differs from what was written; pruned files are skipped."""
    for roll in rolls:
        path, described = folder / roll.path, f"{roll.path}, which holds {rows_text((roll.first_row, roll.end_row))},"
        if roll.pruned_s is not None:
            continue
        try:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as cause:
            yield f"{described} cannot be read: {cause.strerror}."
            continue
        if digest != roll.sha256:
            yield f"{described} differs from what was written."


def uncovered(gap: Span, spans: Iterable[Span]) -> list[Span]:
    """Return the parts of a gap, in rows, that no span covers."""
    first, end = gap
    left = []
    for start, stop in sorted(spans):
        if start >= end or stop <= first:
            continue
        if start > first:
            left.append((first, start))
        first = max(first, stop)
    return [*left, (first, end)] if first < end else left


def rows_text(rows: Span) -> str:
    """Return a span of rows in words, for example "rows 3 to 7" with the last row included."""
    first, end = rows
    return f"row {first}" if end == first + 1 else f"rows {first} to {end - 1}"


def _broken_seals(connection: sqlite3.Connection, table: str) -> Iterator[str]:
    kind = next(kind for kind, name in TABLES.items() if name == table)
    after = f" WHERE number > {last_rolled_block(connection)}" if kind is BlockRow else ""
    for row in connection.execute(f"SELECT * FROM {table}{after}"):
        try:
            unseal(kind, row)
        except BrokenSealError as cause:
            yield f"{str(cause).capitalize()}."


def _row_faults(connection: sqlite3.Connection) -> Iterator[str]:
    """Yield a sentence for each repeat of rows, unrecorded gap, wrong number of rows in a file, and missing block."""
    holes = list(connection.execute("SELECT first_row, end_row FROM holes"))
    expected = 0
    for path, first_row, end_row, rows in connection.execute(
        "SELECT path, first_row, end_row, rows FROM rolls ORDER BY number"
    ):
        yield from _discontinuity(expected, first_row, holes, path)
        lost = end_row - first_row - sum(b - a for a, b in uncovered((first_row, end_row), holes))
        if rows + lost != end_row - first_row:
            yield f"{path} should hold {end_row - first_row - lost} rows, but its record says {rows}."
        expected = max(expected, end_row)
    number = last_rolled_block(connection)
    for block, first_row, end_row in connection.execute(_BLOCKS, (number,)):
        if block != number + 1:
            yield f"Blocks {number + 1} to {block - 1} are missing."
        yield from _discontinuity(expected, first_row, holes, f"block {block}")
        number, expected = block, max(expected, end_row)


def _discontinuity(expected: int, first_row: int, holes: list[Span], where: str) -> Iterator[str]:
    if first_row < expected:
        yield f"{rows_text((first_row, expected)).capitalize()} occur twice, before and in {where}."
    for gap in uncovered((expected, first_row), holes) if first_row > expected else []:
        yield f"{rows_text(gap).capitalize()} are missing before {where}."
