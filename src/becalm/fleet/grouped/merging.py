"""Merge the strips of one sensor, so that its rows are in the order of time; the memory needed is bounded."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from becalm.files.lake.folder import refuse_different
from becalm.files.parquet import units_of
from becalm.files.rows import MemoryRows
from becalm.files.source import RawTable
from becalm.fleet.grouped.strips import RANK, Strip


class StripCursor:
    """A cursor that reads a strip message by message.

    Its file is open only during a read, because there may be thousands of strips.

    Parameters
    ----------
    strip : Strip
        The strip to read.

    Attributes
    ----------
    columns : pyarrow.Schema
        The columns of the strip, without the rank.
    left : int
        Number of rows that have not been read yet.
    last_rank : int, float or None
        The rank of the last row that was loaded; before the first load, the rank of the first row.
    """

    def __init__(self, strip: Strip) -> None:
        self._path, self.left, self.last_rank = strip.path, strip.rows, strip.first
        with pa.OSFile(self._path) as file:
            file.seek(strip.offset)
            self._schema: pa.Schema = pa.ipc.read_schema(file)
            self._at: int = file.tell()
        self.columns: pa.Schema = self._schema.remove(self._schema.get_field_index(RANK))
        self._loaded: pa.Table = self._schema.empty_table()

    @property
    def loaded_rows(self) -> int:
        """Return the number of rows in memory."""
        return int(self._loaded.num_rows)

    def read(self) -> pa.Table:
        """Read the next message and return its rows, without keeping them in memory."""
        with pa.OSFile(self._path) as file:
            file.seek(self._at)
            batch = pa.ipc.read_record_batch(pa.ipc.read_message(file), self._schema)
            self._at = file.tell()
        self.left -= batch.num_rows
        return pa.table(batch)

    def load(self) -> None:
        """Read the next message into memory, in place of the rows there."""
        self._loaded = self.read()
        self.last_rank = _ranks(self._loaded)[-1]

    def take(self, stop: Any, *, also_equal: bool) -> pa.Table:
        """Remove from memory, and return, the rows with a rank below `stop`, with `also_equal` up to `stop`."""
        count = int(np.searchsorted(_ranks(self._loaded), stop, "right" if also_equal else "left"))
        taken, rest = self._loaded.slice(0, count), self._loaded.slice(count)
        self._loaded = (
            rest if rest.num_rows else self._schema.empty_table()
        )  # an empty slice would keep the whole buffer
        return taken

    def all_loaded(self) -> pa.Table:
        """Return all rows in memory."""
        return self._loaded


def merge_strips(lake: Path, strips: Sequence[Strip]) -> Iterator[pa.Table]:
    """Yield the rows of strips in the order of their ranks; rows of equal rank keep the order of strips and rows.

    If a strip has no ranks, all rows keep their original order.

    Parameters
    ----------
    lake : Path
        The lake of the rows, for messages.
    strips : sequence of Strip
        All strips of one sensor, in the order of its files.

    Raises
    ------
    InputError
        If the strips do not have the same columns.
    """
    heads = [StripCursor(strip) for strip in strips]
    first = heads[0].columns
    for strip, head in zip(strips, heads, strict=True):
        if head.columns != first:
            refuse_different(lake / strip.file, _empty_table(head.columns), lake / strips[0].file, _empty_table(first))
    schema = pa.schema([field.with_nullable(True) for field in first], first.metadata)
    ranked = all(strip.first is not None for strip in strips)
    for parts in _by_rank(heads) if ranked else _in_file_order(heads):
        yield _join_sorted([part for part in parts if part.num_rows], schema)


def _in_file_order(heads: Sequence[StripCursor]) -> Iterator[list[pa.Table]]:
    for head in heads:
        while head.left:
            yield [head.read()]


def _by_rank(heads: Sequence[StripCursor]) -> Iterator[list[pa.Table]]:
    """Yield, step by step, the loaded rows that come before all rows not loaded yet, as one table for each cursor.

    A row that is not loaded yet has at least the smallest `last_rank` of the cursors that have unread rows. Only
    cursors with loaded rows are considered; if strips follow each other in time, these cursors are few.
    """
    unread = [(head.last_rank, place) for place, head in enumerate(heads)]
    heapq.heapify(unread)
    in_memory = list[int]()
    while unread:
        last_rank, first = unread[0]
        yield [heads[place].take(last_rank, also_equal=place <= first) for place in in_memory]
        head = heads[first]
        head.load()
        in_memory = sorted({place for place in in_memory if heads[place].loaded_rows} | {first})
        if head.left:
            heapq.heapreplace(unread, (head.last_rank, first))
        else:
            heapq.heappop(unread)
    yield [heads[place].all_loaded() for place in in_memory]


def _join_sorted(parts: Sequence[pa.Table], schema: pa.Schema) -> pa.Table:
    """Join tables of several strips and sort the rows by rank."""
    if not parts:
        return schema.empty_table()
    tables = [pa.table([part.column(name) for name in schema.names], schema=schema) for part in parts]
    if len(parts) == 1:
        return tables[0]
    order = np.argsort(np.concatenate([_ranks(part) for part in parts]), kind="stable")
    return pa.concat_tables(tables).combine_chunks().take(order)


def _ranks(table: pa.Table) -> Any:
    return table.column(RANK).to_numpy()


def _empty_table(columns: pa.Schema) -> RawTable:
    """Return an empty table with these columns, for error messages."""
    return RawTable(MemoryRows(columns.empty_table()), 0, "parquet", units_of(columns))
