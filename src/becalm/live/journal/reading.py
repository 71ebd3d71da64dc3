"""Read a journal in order, from Parquet files and database, while its stream may continue."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from becalm.files.outputs.tables import VERDICT, verdict_words
from becalm.live.block import Checkpoint, Head
from becalm.live.closing import Closing
from becalm.live.journal.database import NAME, JournalError, connect_reading, get, last_rolled_block, reading
from becalm.live.journal.records import BlockRow, HeadRow, HoleRow, LossRow, RollRow
from becalm.live.journal.row_bytes import unpack_rows
from becalm.live.tables import ROW, TIME, output_table, table_schema

_BATCH_ROWS = 1 << 16  # most rows in a table from a file
_SPANS = """SELECT period_s, dated, CAST(first_row AS INTEGER), CAST(end_row AS INTEGER), CAST(first_s AS REAL),
    CAST(last_s AS REAL), length(data) FROM blocks WHERE number > ? AND end_row > first_row ORDER BY number"""
# the casts are needed because a damaged row may hold values of any type


class JournalStretch(NamedTuple):
    """Rows of an hour, in a Parquet file or still in the database."""

    where: str  # path of the file in the folder, or the database's name
    first_row: int
    end_row: int  # the row after the last
    rows: int  # fewer than end_row - first_row if rows were lost
    first_s: float | None  # stamps in seconds
    last_s: float | None
    dated: bool  # True if the hour comes from the stamps, not from the arrival time
    size: int  # bytes
    pruned: bool  # True if the file was removed because of its age

    @property
    def rate_hz(self) -> float | None:
        """Return the mean sample rate in hertz from the first and last stamps; None if they give no rate."""
        if self.first_s is None or self.last_s is None or not self.last_s > self.first_s:
            return None
        return (self.rows - 1) / (self.last_s - self.first_s)


def open_journal(folder: str | os.PathLike[str]) -> JournalReader:
    """Open a journal for reading; its stream may continue meanwhile.

    Parameters
    ----------
    folder : path-like
        DIR of `journal:DIR`.

    Raises
    ------
    JournalError
        If the folder has no journal, or it cannot be read.
    """
    return JournalReader(Path(folder))


class JournalReader(Closing):
    """A reader of a journal, made by `open_journal`; close it with `with` or `close`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        path = folder / NAME
        if not path.is_file():
            raise JournalError(f"{folder} holds no journal ({NAME}); give the DIR of becalm live --sink journal:DIR.")
        with reading(folder):
            self.connection = connect_reading(path)

    def close(self) -> None:
        """Close the database; may be called twice."""
        self.connection.close()

    def head(self) -> Head | None:
        """Return names, units, rate and the last recipe; None if no stream has started."""
        with reading(self.folder):
            heads = get(self.connection, HeadRow, "ORDER BY number DESC LIMIT 1")
        return heads[0].head() if heads else None

    def checkpoint(self) -> Checkpoint | None:
        """Return the last checkpoint; None if nothing is committed."""
        with self._read_transaction():
            blocks = get(self.connection, BlockRow, "ORDER BY number DESC LIMIT 1")
            heads = get(self.connection, HeadRow, "ORDER BY number DESC LIMIT 1")
        return blocks[0].checkpoint(heads[0].recipe) if blocks else None

    def losses(self) -> list[LossRow]:
        """Return the losses of the stream, in the order in which they were recorded."""
        with reading(self.folder):
            return get(self.connection, LossRow)

    def holes(self) -> list[tuple[int, int]]:
        """Return spans (first row, end row) of rows that were committed and are known to be lost."""
        with reading(self.folder):
            return [(hole.first_row, hole.end_row) for hole in get(self.connection, HoleRow)]

    def rolls(self) -> list[RollRow]:
        """Return the records of all files in row order, including files that were removed because of their age."""
        with reading(self.folder):
            return get(self.connection, RollRow)

    def stretches(self) -> list[JournalStretch]:
        """Return the journal's contents: one entry for each file, and one for each hour still in the database."""
        with self._read_transaction():
            rolls = get(self.connection, RollRow)
            blocks = self.connection.execute(_SPANS, (last_rolled_block(self.connection),)).fetchall()
        stretches = [
            JournalStretch(
                r.path, r.first_row, r.end_row, r.rows, r.first_s, r.last_s, bool(r.dated), r.size, bool(r.pruned_s)
            )
            for r in rolls
        ]
        hour = None
        for period_s, dated, first_row, end_row, first_s, last_s, size in blocks:
            rows = end_row - first_row
            if hour == (period_s, dated):
                last = stretches[-1]
                rows, size = last.rows + rows, last.size + size
                stretches[-1] = last._replace(end_row=end_row, rows=rows, last_s=last_s, size=size)
            else:
                stretches.append(
                    JournalStretch(NAME, first_row, end_row, rows, first_s, last_s, bool(dated), size, False)
                )
            hour = (period_s, dated)
        return stretches

    def tables(self, first_row: int = 0, from_s: float = -inf, to_s: float = inf) -> Iterator[pa.Table]:
        """Yield rows in order in tables of bounded size, including rows that are committed meanwhile.

        Parameters
        ----------
        first_row : int
            Number of the first row to return.
        from_s, to_s : float
            Range of the stamps in seconds; `to_s` is excluded.

        Yields
        ------
        pyarrow.Table
            Rows in the columns of `becalm.live.tables.output_table`.

        Raises
        ------
        JournalError
            If some rows cannot be read.
        """
        row, roll, block = first_row, 0, 0
        while (piece := self._next(row, roll, block)) is not None:
            head, record = piece
            schema = table_schema(head)
            if isinstance(record, RollRow):
                roll = record.number
                tables = self._read_file(record, schema, from_s, to_s)
            else:
                block = record.number
                tables = iter([output_table(head, [unpack_rows(record)])])
            for table in tables:
                if (part := _within(table, row, from_s, to_s)).num_rows:
                    yield part
            row = record.end_row

    @contextmanager
    def _read_transaction(self) -> Iterator[None]:
        """Run all queries of the `with` block on the same state of the database."""
        with reading(self.folder):
            self.connection.execute("BEGIN")
            try:
                yield
            finally:
                if self.connection.in_transaction:
                    self.connection.execute("ROLLBACK")

    def _next(self, row: int, roll: int, block: int) -> tuple[Head, RollRow | BlockRow] | None:
        """Return the first file after file `roll`, else the first block after `block`, that has rows from `row` on."""
        with self._read_transaction():
            after = "WHERE number > ? AND end_row > ? AND pruned_s IS NULL ORDER BY number LIMIT 1"
            records: list[RollRow] | list[BlockRow] = get(self.connection, RollRow, after, (roll, row))
            if not records:
                least = max(block, last_rolled_block(self.connection))
                after = "WHERE number > ? AND end_row > max(first_row, ?) ORDER BY number LIMIT 1"
                records = get(self.connection, BlockRow, after, (least, row))
            if not records:
                return None
            head = get(self.connection, HeadRow, "WHERE number = ?", (records[0].head,))[0].head()
        return head, records[0]

    def _read_file(self, roll: RollRow, schema: pa.Schema, from_s: float, to_s: float) -> Iterator[pa.Table]:
        path = self.folder / roll.path
        try:
            with pq.ParquetFile(path) as file:
                for group in range(file.num_row_groups):
                    if _outside(file.metadata.row_group(group), from_s, to_s):
                        continue
                    for batch in file.iter_batches(_BATCH_ROWS, row_groups=[group]):
                        yield _with_verdict_words(pa.Table.from_batches([batch]), schema)
        except (OSError, pa.ArrowException) as cause:
            raise JournalError(
                f"{path} cannot be read ({' '.join(str(cause).split())[:200]}); type `becalm journal {self.folder}"
                " verify` to see what else is wrong."
            ) from cause


def _outside(group: pq.RowGroupMetaData, from_s: float, to_s: float) -> bool:
    """Return whether all stamps of a row group are outside a range; False if its statistics are unknown."""
    stamps = group.column(1).statistics  # column time_s
    return stamps is not None and stamps.has_min_max and (stamps.max < from_s or stamps.min >= to_s)


def _within(table: pa.Table, first_row: int, from_s: float, to_s: float) -> pa.Table:
    if table[ROW][0].as_py() < first_row:
        table = table.filter(pc.greater_equal(table[ROW], first_row))
    if (from_s, to_s) != (-inf, inf):
        stamps = table[TIME]
        table = table.filter(pc.and_(pc.greater_equal(stamps, from_s), pc.less(stamps, to_s)))
    return table


def _with_verdict_words(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """Return rows of a file with the same verdict dictionary as rows of a block."""
    words = verdict_words(np.empty(0, np.int8)).dictionary
    columns = []
    for name, column in zip(table.column_names, table.columns, strict=True):
        if name.endswith(VERDICT) and pa.types.is_dictionary(column.type):
            codes = pc.index_in(column.combine_chunks().dictionary_decode(), words).cast(pa.int8())
            columns.append(pa.DictionaryArray.from_arrays(codes, words))
        else:
            columns.append(column)
    return pa.table(columns, schema=schema)
