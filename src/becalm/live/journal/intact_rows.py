"""Read the intact rows of a damaged journal, and plan the new journal that is made from them."""

from __future__ import annotations

import hashlib
import sqlite3
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from urllib.parse import quote

import pyarrow as pa
import pyarrow.parquet as pq

from becalm.live.journal.checking import Span, uncovered
from becalm.live.journal.database import NAME, BrokenSealError, last_rolled_block, unseal
from becalm.live.journal.first_page import copy_with_first_page, is_sound
from becalm.live.journal.mark import Mark
from becalm.live.journal.records import TABLES, BlockRow, HeadRow, HoleRow, LossRow, RollRow
from becalm.live.journal.rolling import END_ROW, FIRST_ROW

HEADED = f"{NAME}.headed"
"""Name of a copy of the damaged database with an intact first page."""

Row = TypeVar("Row", bound=tuple[Any, ...])


class IntactRows(NamedTuple):
    """The intact rows of a damaged journal, ordered by number."""

    heads: list[HeadRow]
    rolls: list[RollRow]
    blocks: list[BlockRow]  # without data
    losses: list[LossRow]
    holes: list[HoleRow]


@dataclass(frozen=True)
class Plan:
    """Contents of the new database.

    Attributes
    ----------
    rows : list of tuple
        Rows of all tables except blocks.
    blocks : list of (int or None, BlockRow)
        Number of a block in the damaged database, and its new row without data; None if the block is new.
    gaps : list of (int, int)
        Spans (first row, row after the last) of lost rows before `end` that are not recorded as holes yet.
    end : int
        The row after the last row of the stream.
    """

    rows: list[tuple[Any, ...]]
    blocks: list[tuple[int | None, BlockRow]]
    gaps: list[Span]
    end: int


def connect_damaged(path: Path) -> sqlite3.Connection:
    """Open a damaged, possibly truncated database read-only; an empty database if the file is missing.

    If the first page is damaged, this opens a copy with an intact first page, and leaves the copy as HEADED.

    Raises
    ------
    OSError
        If the copy cannot be written.
    """
    if not path.exists():
        return sqlite3.connect(":memory:", isolation_level=None)
    connection = _connect_read_only(path)
    if is_sound(connection):
        return connection
    connection.close()
    copy = path.with_name(HEADED)
    copy_with_first_page(path, copy)
    return _connect_read_only(copy)


def _connect_read_only(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro", uri=True, isolation_level=None)
    with suppress(sqlite3.Error):
        connection.execute("PRAGMA writable_schema = ON")  # to read a file that is shorter than its header states
    return connection


def read_intact_rows(connection: sqlite3.Connection) -> IntactRows:
    """Return all intact rows, except the blocks whose rows are in files."""
    try:
        rolled = last_rolled_block(connection)
    except (sqlite3.Error, BrokenSealError):
        rolled = 0
    numbers = [number for number in _numbers(connection, TABLES[BlockRow]) if number > rolled]
    blocks = [row._replace(data=None) for row in _read(connection, BlockRow, numbers)]
    return IntactRows(
        _intact(connection, HeadRow),
        _intact(connection, RollRow),
        blocks,
        _intact(connection, LossRow),
        _intact(connection, HoleRow),
    )


def with_data(source: sqlite3.Connection, old: int, new: BlockRow) -> BlockRow:
    """Return the new row of a block with the data of block `old`."""
    return new._replace(data=next(_read(source, BlockRow, [old])).data)


def plan_repair(folder: Path, intact: IntactRows, mark: Mark | None) -> Plan | None:
    """Return the plan of the new database; None if no checkpoint is left from which the stream could continue."""
    rolls = _all_files(folder, intact)
    end = rolls[-1].end_row if rolls else 0
    heads = list(intact.heads)
    if mark is not None and mark.head.recipe not in [head.recipe for head in heads]:
        heads.append(HeadRow.of(max([0, *(head.number for head in heads)]) + 1, mark.head))
    kept = _in_order(intact.blocks, end)
    if not heads or not (kept or (mark is not None and mark.checkpoint.rows >= end)):
        return None
    head_numbers, last = {head.number for head in heads}, heads[-1].number
    blocks: list[tuple[int | None, BlockRow]] = [
        (block.number, block._replace(number=number, head=block.head if block.head in head_numbers else last))
        for number, block in enumerate(kept, 1)
    ]
    if mark is not None and not kept:
        checkpoint = (mark.checkpoint.position, mark.checkpoint.source, mark.checkpoint.snapshot)
        row = mark.checkpoint.rows
        blocks = [(None, BlockRow(1, last, row, row, None, None, time.time(), 0, 0, *checkpoint, None))]
    end = blocks[-1][1].end_row
    pieces: list[RollRow | BlockRow | HoleRow] = [*rolls, *kept, *intact.holes]
    gaps = uncovered((0, end), [(piece.first_row, piece.end_row) for piece in pieces])
    files = [roll._replace(number=number, last_block=0) for number, roll in enumerate(rolls, 1)]
    holes = [HoleRow(None, *gap) for gap in gaps]
    return Plan([*heads, *files, *intact.losses, *intact.holes, *holes], blocks, gaps, end)


def _in_order(blocks: Sequence[BlockRow], end: int) -> list[BlockRow]:
    """Return the blocks from row `end` on that do not overlap, up to the last one with a snapshot."""
    kept: list[BlockRow] = []
    for block in blocks:
        if block.first_row >= end:
            kept.append(block)
            end = block.end_row
    while kept and kept[-1].snapshot is None:
        kept.pop()
    return kept


def _all_files(folder: Path, intact: IntactRows) -> list[RollRow]:
    """Return the records of all files in row order, including files whose record is lost."""
    rolls = sorted(intact.rolls, key=lambda roll: roll.first_row)
    spans = [(roll.first_row, roll.end_row) for roll in rolls]
    blocks = [(block.first_row, block.end_row) for block in intact.blocks]
    recorded = {roll.path for roll in rolls}
    head = intact.heads[-1].number if intact.heads else 1
    for path in sorted(folder.glob("*/*.parquet")):
        name = path.relative_to(folder).as_posix()
        roll = None if name in recorded else _record_of(path, name, head)
        if roll is None:
            continue
        span = (roll.first_row, roll.end_row)
        if uncovered(span, spans) == [span] and uncovered(span, blocks):  # blocks that cover a file are rolled again
            rolls.append(roll)
            spans.append(span)
    return sorted(rolls, key=lambda roll: roll.first_row)


def _record_of(path: Path, name: str, head: int) -> RollRow | None:
    """Return the record of a file; None if it is damaged or not a file of a journal."""
    try:
        with pq.ParquetFile(path) as file:
            metadata = file.schema_arrow.metadata or {}
            span = (int(metadata[FIRST_ROW]), int(metadata[END_ROW]))
            times = file.read(["time_s"]).column(0)
    except (OSError, KeyError, ValueError, pa.ArrowException):
        return None
    first_s, last_s = (times[0].as_py(), times[-1].as_py()) if len(times) else (None, None)
    contents = (*span, len(times), first_s, last_s, int(not path.name.startswith("rows-")))
    with path.open("rb") as content:
        digest = hashlib.file_digest(content, "sha256").hexdigest()
    return RollRow(0, name, head, 0, *contents, time.time(), path.stat().st_size, digest, None)


def _intact(connection: sqlite3.Connection, kind: type[Row]) -> list[Row]:
    return list(_read(connection, kind, _numbers(connection, TABLES[kind])))


def _read(connection: sqlite3.Connection, kind: type[Row], numbers: Iterable[int]) -> Iterator[Row]:
    """Yield the intact rows with these numbers."""
    for number in numbers:
        with suppress(sqlite3.Error, BrokenSealError):
            row = connection.execute(f"SELECT * FROM {TABLES[kind]} WHERE number = ?", (number,)).fetchone()
            if row is not None:
                yield unseal(kind, row)


def _numbers(connection: sqlite3.Connection, table: str) -> list[int]:
    """Return the numbers of a table's rows; in a damaged table, also all numbers between the readable ones."""
    numbers: list[int] = []
    for order in ("ASC", "DESC"):
        with suppress(sqlite3.Error):
            for (number,) in connection.execute(f"SELECT number FROM {table} ORDER BY number {order}"):
                numbers.append(number)
            return sorted(numbers)  # the whole table is readable
    return list(range(min(numbers), max(numbers) + 1)) if numbers else []
