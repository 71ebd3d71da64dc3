"""Write completed hours of a journal to Parquet files."""

from __future__ import annotations

import hashlib
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from threading import Event
from typing import NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from becalm.files.atomic_file import explain_write_errors, replacing
from becalm.files.outputs.tables import VERDICT
from becalm.files.roles import SIGMA
from becalm.live.block import Head, Output
from becalm.live.journal.database import BrokenSealError, get
from becalm.live.journal.records import BlockRow, HeadRow, HoleRow, RollRow
from becalm.live.journal.row_bytes import unpack_rows
from becalm.live.tables import output_table, table_schema

FIRST_ROW, END_ROW = b"becalm.first_row", b"becalm.end_row"
"""Keys of a file's metadata: the first row of the stream that it holds, and the row after the last."""

MOST_BYTES = 1 << 30
"""Bytes of blocks that complete a file before its hour ends, so that the size of database and files is bounded."""

_GROUP_ROWS, _GROUP_BYTES = 1 << 20, 16 << 20  # most rows, and bytes of blocks, in a Parquet row group
_SPAN = "SELECT first_row, end_row FROM blocks WHERE number = ?"


class Stopped(Exception):  # noqa: N818  (not an error)
    """Raised if the stream ends while a file is written; the next start writes it again."""


class Piece(NamedTuple):
    """Consecutive blocks that are written to one file."""

    first_block: int
    last_block: int
    head: int
    period_s: int
    dated: bool
    first_row: int
    end_row: int
    first_s: float | None
    last_s: float | None


class Rolled(NamedTuple):
    """The record of a written file, without its number, and its holes."""

    row: RollRow
    holes: tuple[HoleRow, ...]


def next_piece(connection: sqlite3.Connection, after: int) -> Piece | None:
    """Return the first blocks after block `after` that make a file: a completed hour, or MOST_BYTES of it.

    Return None if there are none. The last block of the journal is never included, because it holds the checkpoint.
    """
    cursor = connection.execute(
        "SELECT number, head, period_s, dated, first_row, end_row, first_s, last_s, length(data) FROM blocks"
        " WHERE number > ? ORDER BY number",
        (after,),
    )
    with closing(cursor):
        piece, size = None, 0
        for number, head, period_s, dated, first_row, end_row, first_s, last_s, length in cursor:
            has_rows = end_row > first_row
            if piece is None:
                if has_rows:
                    piece = Piece(number, number, head, period_s, bool(dated), first_row, end_row, first_s, last_s)
            elif size >= MOST_BYTES or (has_rows and (head, period_s, dated) != piece[2:5]):
                return piece
            elif has_rows:
                piece = piece._replace(last_block=number, end_row=end_row, last_s=last_s)
            else:
                piece = piece._replace(last_block=number)
            size += length or 0
    return None


def roll(connection: sqlite3.Connection, folder: Path, piece: Piece, stop: Event) -> Rolled:
    """Write blocks to a Parquet file, atomically; return its record.

    Raises
    ------
    Stopped
        If `stop` is set meanwhile; no file is left.
    OutputError
        If the file cannot be written; no file is left.
    BrokenSealError
        If a block is missing or the head is damaged; no file is left.
    """
    head = _head(connection, piece.head)
    path = _free_path(connection, folder, piece)
    holes: list[HoleRow] = []
    with explain_write_errors(path):
        path.parent.mkdir(exist_ok=True)
    row_span = {FIRST_ROW: str(piece.first_row).encode(), END_ROW: str(piece.end_row).encode()}
    schema = table_schema(head)
    schema = schema.with_metadata({**(schema.metadata or {}), **row_span})
    repeating = [name for name in schema.names if name.endswith((SIGMA, VERDICT))]
    with replacing(path) as file, explain_write_errors(path):
        with pq.ParquetWriter(file, schema, use_dictionary=repeating, compression="zstd") as writer:
            for outputs in _groups(connection, piece, holes, stop):
                table = output_table(head, outputs).replace_schema_metadata(schema.metadata)
                writer.write_table(table, row_group_size=_GROUP_ROWS)
        size = file.seek(0, 2)
        file.seek(0)
        digest = hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]  # it is a binary file
    rows = piece.end_row - piece.first_row - sum(hole.end_row - hole.first_row for hole in holes)
    name = path.relative_to(folder).as_posix()
    spans = (piece.first_row, piece.end_row, rows, piece.first_s, piece.last_s, int(piece.dated))
    row = RollRow(0, name, piece.head, piece.last_block, *spans, time.time(), size, digest, None)
    return Rolled(row, tuple(holes))


def _head(connection: sqlite3.Connection, number: int) -> Head:
    return get(connection, HeadRow, "WHERE number = ?", (number,))[0].head()


def _groups(connection: sqlite3.Connection, piece: Piece, holes: list[HoleRow], stop: Event) -> Iterator[list[Output]]:
    """Yield the outputs of each row group; the rows of a damaged block are added to `holes`."""
    group: list[Output] = []
    rows = size = 0
    for number in range(piece.first_block, piece.last_block + 1):
        if stop.is_set():
            raise Stopped
        span = connection.execute(_SPAN, (number,)).fetchone()
        if span is None:
            raise BrokenSealError(f"block {number} is missing")
        first_row, end_row = span
        if first_row == end_row:
            continue
        try:
            (block,) = get(connection, BlockRow, "WHERE number = ?", (number,))
        except (BrokenSealError, sqlite3.DatabaseError):
            holes.append(HoleRow(None, first_row, end_row))
            continue
        group.append(unpack_rows(block))
        rows += len(group[-1])
        size += len(block.data or b"")
        if rows >= _GROUP_ROWS or size >= _GROUP_BYTES:
            yield group
            group, rows, size = [], 0, 0
    if group:
        yield group


def _free_path(connection: sqlite3.Connection, folder: Path, piece: Piece) -> Path:
    """Return the path for a piece; an unrecorded file with the same first row, left by a crash, is replaced."""
    start = datetime.fromtimestamp(piece.period_s, UTC)
    if piece.dated:
        stem = f"{start:%H}" if start.minute == start.second == 0 else f"{start:%H_%M_%S}"
    else:
        stem = f"rows-{piece.first_row:012d}"
    taken = {path for (path,) in connection.execute("SELECT path FROM rolls")}
    for turn in count(1):
        path = folder / f"{start:%Y-%m-%d}" / f"{stem}{'' if turn == 1 else f'_{turn:02d}'}.parquet"
        if path.relative_to(folder).as_posix() not in taken and (not path.exists() or _begins_with(path, piece)):
            return path
    raise AssertionError  # count never ends


def _begins_with(path: Path, piece: Piece) -> bool:
    """Return whether a file begins with the first row of a piece."""
    try:
        metadata = pq.read_schema(path).metadata or {}
    except (OSError, pa.ArrowException):
        return False
    return metadata.get(FIRST_ROW) == str(piece.first_row).encode()
