"""A journal read in order, rolled or not, while its stream may go on."""

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

from becalm.files.tables import VERDICT, in_words
from becalm.live.block import Checkpoint, Head
from becalm.live.closing import Closing
from becalm.live.journal.database import NAME, JournalError, connect_reading, get, reading, rolled_blocks
from becalm.live.journal.records import BlockRow, HeadRow, HoleRow, LossRow, RollRow
from becalm.live.journal.row_bytes import unpacked
from becalm.live.tables import ROW, TIME, output_table, table_schema

_BATCH_ROWS = 1 << 16
_SPANS = """SELECT period_s, dated, CAST(first_row AS INTEGER), CAST(end_row AS INTEGER), CAST(first_s AS REAL),
    CAST(last_s AS REAL), length(data) FROM blocks WHERE number > ? AND end_row > first_row ORDER BY number"""
# of the types that they have, for a damaged row may hold anything


class JournalStretch(NamedTuple):
    """Rows of an hour, in a file of their own or in the database still."""

    where: str
    first_row: int
    end_row: int
    rows: int
    first_s: float | None
    last_s: float | None
    dated: bool
    size: int
    pruned: bool

    @property
    def rate_hz(self) -> float | None:
        """Rows a second, by the first and the last stamp."""
        if self.first_s is None or self.last_s is None or not self.last_s > self.first_s:
            return None
        return (self.rows - 1) / (self.last_s - self.first_s)


def open_journal(folder: str | os.PathLike[str]) -> JournalReader:
    """Open a journal to read; its stream may go on meanwhile.

    Parameters
    ----------
    folder : path-like
        DIR of `journal:DIR`.

    Raises
    ------
    JournalError
        If there is none, or it cannot be read.
    """
    return JournalReader(Path(folder))


class JournalReader(Closing):
    """Reads a journal; made by `open_journal`, closed by `with` or `close`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        path = folder / NAME
        if not path.is_file():
            raise JournalError(f"{folder} holds no journal ({NAME}); give the DIR of becalm live --sink journal:DIR.")
        with reading(folder):
            self.connection = connect_reading(path)

    def close(self) -> None:
        """Let go; harmless twice."""
        self.connection.close()

    def head(self) -> Head | None:
        """Return what all rows share, with the last recipe; None before a stream began."""
        with reading(self.folder):
            found = get(self.connection, HeadRow, "ORDER BY number DESC LIMIT 1")
        return found[0].head() if found else None

    def checkpoint(self) -> Checkpoint | None:
        """Return where the stream stands."""
        with self._moment():
            blocks = get(self.connection, BlockRow, "ORDER BY number DESC LIMIT 1")
            heads = get(self.connection, HeadRow, "ORDER BY number DESC LIMIT 1")
        return blocks[0].checkpoint(heads[0].recipe) if blocks else None

    def losses(self) -> list[LossRow]:
        """Return what happened to the stream, in the order in which it was told."""
        with reading(self.folder):
            return get(self.connection, LossRow)

    def holes(self) -> list[tuple[int, int]]:
        """Return which rows were kept and are known to be lost: the first, and the one after the last."""
        with reading(self.folder):
            return [(hole.first_row, hole.end_row) for hole in get(self.connection, HoleRow)]

    def rolls(self) -> list[RollRow]:
        """Return the files, in the order of rows, with those that were removed as too old."""
        with reading(self.folder):
            return get(self.connection, RollRow)

    def stretches(self) -> list[JournalStretch]:
        """Return what the journal holds: a stretch for each file, and for each hour that has not rolled."""
        with self._moment():
            rolls = get(self.connection, RollRow)
            blocks = self.connection.execute(_SPANS, (rolled_blocks(self.connection),)).fetchall()
        found = [
            JournalStretch(
                r.path, r.first_row, r.end_row, r.rows, r.first_s, r.last_s, bool(r.dated), r.size, bool(r.pruned_s)
            )
            for r in rolls
        ]
        hour = None
        for period_s, dated, first_row, end_row, first_s, last_s, size in blocks:
            rows = end_row - first_row
            if hour == (period_s, dated):
                last = found[-1]
                rows, size = last.rows + rows, last.size + size
                found[-1] = last._replace(end_row=end_row, rows=rows, last_s=last_s, size=size)
            else:
                found.append(JournalStretch(NAME, first_row, end_row, rows, first_s, last_s, bool(dated), size, False))
            hour = (period_s, dated)
        return found

    def tables(self, first_row: int = 0, from_s: float = -inf, to_s: float = inf) -> Iterator[pa.Table]:
        """Go through rows in order, a bounded number at a time; what is kept meanwhile comes too.

        Parameters
        ----------
        first_row : int
            Where to begin.
        from_s, to_s : float
            Which stamps, in seconds; the last excluded.

        Yields
        ------
        pyarrow.Table
            As `becalm.live.tables.output_table` makes it.

        Raises
        ------
        JournalError
            If some rows cannot be read.
        """
        row, roll, block = first_row, 0, 0
        while (piece := self._next(row, roll, block)) is not None:
            head, found = piece
            schema = table_schema(head)
            if isinstance(found, RollRow):
                roll = found.number
                tables = self._rolled(found, schema, from_s, to_s)
            else:
                block = found.number
                tables = iter([output_table(head, [unpacked(found)])])
            for table in tables:
                if (part := _within(table, row, from_s, to_s)).num_rows:
                    yield part
            row = found.end_row

    @contextmanager
    def _moment(self) -> Iterator[None]:
        """Read all within as it is at one moment."""
        with reading(self.folder):
            self.connection.execute("BEGIN")
            try:
                yield
            finally:
                if self.connection.in_transaction:
                    self.connection.execute("ROLLBACK")

    def _next(self, row: int, roll: int, block: int) -> tuple[Head, RollRow | BlockRow] | None:
        """Return the file or the block that has a row, or the next one that is there."""
        with self._moment():
            after = "WHERE number > ? AND end_row > ? AND pruned_s IS NULL ORDER BY number LIMIT 1"
            found: list[RollRow] | list[BlockRow] = get(self.connection, RollRow, after, (roll, row))
            if not found:
                least = max(block, rolled_blocks(self.connection))
                after = "WHERE number > ? AND end_row > max(first_row, ?) ORDER BY number LIMIT 1"
                found = get(self.connection, BlockRow, after, (least, row))
            if not found:
                return None
            head = get(self.connection, HeadRow, "WHERE number = ?", (found[0].head,))[0].head()
        return head, found[0]

    def _rolled(self, roll: RollRow, schema: pa.Schema, from_s: float, to_s: float) -> Iterator[pa.Table]:
        path = self.folder / roll.path
        try:
            with pq.ParquetFile(path) as file:
                for group in range(file.num_row_groups):
                    if _outside(file.metadata.row_group(group), from_s, to_s):
                        continue
                    for batch in file.iter_batches(_BATCH_ROWS, row_groups=[group]):
                        yield _as_kept(pa.Table.from_batches([batch]), schema)
        except (OSError, pa.ArrowException) as cause:
            raise JournalError(
                f"{path} cannot be read ({' '.join(str(cause).split())[:200]}); `becalm journal {self.folder} verify`"
                " tells what else is wrong."
            ) from cause


def _outside(group: pq.RowGroupMetaData, from_s: float, to_s: float) -> bool:
    """Whether no stamp of a row group is asked for, where that is known."""
    told = group.column(1).statistics  # of time_s
    return told is not None and told.has_min_max and (told.max < from_s or told.min >= to_s)


def _within(table: pa.Table, first_row: int, from_s: float, to_s: float) -> pa.Table:
    if table[ROW][0].as_py() < first_row:
        table = table.filter(pc.greater_equal(table[ROW], first_row))
    if (from_s, to_s) != (-inf, inf):
        stamps = table[TIME]
        table = table.filter(pc.and_(pc.greater_equal(stamps, from_s), pc.less(stamps, to_s)))
    return table


def _as_kept(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """Return rows of a file with the dictionary that all blocks have."""
    words = in_words(np.empty(0, np.int8)).dictionary
    columns = []
    for name, column in zip(table.column_names, table.columns, strict=True):
        if name.endswith(VERDICT) and pa.types.is_dictionary(column.type):
            codes = pc.index_in(column.combine_chunks().dictionary_decode(), words).cast(pa.int8())
            columns.append(pa.DictionaryArray.from_arrays(codes, words))
        else:
            columns.append(column)
    return pa.table(columns, schema=schema)
