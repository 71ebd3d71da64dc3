"""Rows of a table that may be larger than memory: given in blocks, as often as asked."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import IO, Any, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.errors import OutputError

BLOCK_ROWS = 1 << 20
BLOCK_BYTES = 64 << 20
HELD_ROWS = 1 << 24
"""A single column of so many rows is held in memory; longer ones go to a temporary file."""

_STAMPS = 1 << 16

Numbers = NDArray[Any]  # float64 or int64


class TableRows(Protocol):
    """A table somewhere: in memory, in a Parquet file, in a temporary file."""

    @property
    def schema(self) -> pa.Schema:
        """Names, all different, and types of the columns."""

    @property
    def count(self) -> int:
        """How many rows there are."""

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Give the named columns from row `start` on, in blocks of up to `most_rows`, none empty."""

    def close(self) -> None:
        """Give back what is held."""


def block_rows(schema: pa.Schema) -> int:
    """Return how many rows of a table make a block."""
    return max(1, min(BLOCK_ROWS, BLOCK_BYTES // (8 * max(1, len(schema)))))


class HeldRows:
    """A table in memory."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table
        self.schema: pa.Schema = table.schema
        self.count: int = table.num_rows

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Give slices of the table."""
        table = self._table.select(list(names))
        for first in range(start, self.count, most_rows):
            yield table.slice(first, most_rows)

    def close(self) -> None:
        """Do nothing: memory gives itself back."""


class SpooledRows:
    """A table in a temporary file that has no name and is gone with the process.

    Parameters
    ----------
    schema : pyarrow.Schema
        Of the tables to come.
    """

    def __init__(self, schema: pa.Schema) -> None:
        self.schema = schema
        self._written: list[str] = schema.names
        self.count = 0
        self.missing = [0] * len(schema)
        self._ends: list[int] = []
        with _room():
            self._file: IO[bytes] = tempfile.TemporaryFile(prefix="becalm.")  # noqa: SIM115  (it lives as long as we do)
        self._writer = pa.ipc.new_file(pa.PythonFile(self._file, "w"), schema)
        self._input: pa.PythonFile | None = None

    def add(self, table: pa.Table) -> None:
        """Write the next rows."""
        for batch in table.combine_chunks().to_batches():
            with _room():
                self._writer.write_batch(batch)
            self.count += batch.num_rows
            self._ends.append(self.count)
        for position, column in enumerate(table.columns):
            self.missing[position] += column.null_count

    def keep(self, names: Sequence[str]) -> None:
        """Forget all other columns."""
        fields = [self.schema.field(name) for name in names]
        self.schema = pa.schema(fields, metadata=self.schema.metadata)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Read batches back, only the columns that are asked for."""
        reader = self._reader(names)
        for number, end in enumerate(self._ends):
            if end <= start:
                continue
            batch = reader.get_batch(number)
            first = max(0, start - (end - batch.num_rows))
            table = pa.Table.from_batches([batch]).select(list(names))
            for at in range(first, batch.num_rows, most_rows):
                yield table.slice(at, most_rows)

    def _reader(self, names: Sequence[str]) -> pa.ipc.RecordBatchFileReader:
        if self._input is None:
            with _room():
                self._writer.close()
                self._file.flush()
            self._input = pa.PythonFile(self._file, "r")
        wanted = [position for position, name in enumerate(self._written) if name in names]
        return pa.ipc.open_file(self._input, options=pa.ipc.IpcReadOptions(included_fields=wanted))

    def close(self) -> None:
        """Remove the file."""
        self._file.close()


@contextmanager
def _room() -> Iterator[None]:
    """Say what to do where there is no room for temporary files."""
    try:
        yield
    except OSError as cause:
        raise OutputError(
            f"The folder for temporary files, {tempfile.gettempdir()}, cannot take what a recording of this length"
            f" needs ({cause.strerror or cause}). Make room, or name another: TMPDIR=FOLDER becalm ..."
        ) from cause


def rebatched(blocks: Iterable[pa.Table], rows: int) -> Iterator[pa.Table]:
    """Cut blocks anew: each has exactly `rows` rows, but for the last."""
    held: list[pa.Table] = []
    count = 0
    for block in blocks:
        at = 0
        while count + block.num_rows - at >= rows:
            held.append(block.slice(at, rows - count))
            at += rows - count
            yield pa.concat_tables(held) if len(held) > 1 else held[0]
            held, count = [], 0
        if at < block.num_rows:
            held.append(block.slice(at))
            count += block.num_rows - at
    if held:
        yield pa.concat_tables(held) if len(held) > 1 else held[0]


class Spool:
    """One long column of numbers: in memory while it is short, in a temporary file beyond.

    Parameters
    ----------
    blocks : iterable of (n,) arrays
        All of one type, float64 or int64.
    count : int
        How many numbers there are.
    """

    def __init__(self, blocks: Iterable[Numbers], count: int) -> None:
        self._file: IO[bytes] | None = None
        self._held: Numbers = np.empty(0)
        self.count = count
        if count <= HELD_ROWS:
            at = 0
            for block in blocks:
                if not at:
                    self._held = np.empty(count, block.dtype)
                self._held[at : at + len(block)] = block
                at += len(block)
            return
        with _room():
            self._file = tempfile.TemporaryFile(prefix="becalm.")  # noqa: SIM115  (it lives as long as we do)
        try:
            for block in blocks:
                self._held = np.empty(0, block.dtype)
                with _room():
                    self._file.write(np.ascontiguousarray(block).data)
                    self._file.flush()
        except BaseException:
            self._file.close()
            raise

    def read(self, start: int, stop: int) -> Numbers:
        """Return the numbers from `start` up to `stop`."""
        if self._file is None:
            return self._held[start:stop]
        out = np.empty(max(0, min(stop, self.count) - start), self._held.dtype)
        self._file.seek(start * out.itemsize)
        self._file.readinto(out.data.cast("B"))  # type: ignore[attr-defined]  # a buffered file has it
        return out

    def blocks(self) -> Iterator[Numbers]:
        """Give all numbers in small blocks."""
        for start in range(0, self.count, _STAMPS):
            yield self.read(start, start + _STAMPS)

    def close(self) -> None:
        """Remove the file."""
        if self._file is not None:
            self._file.close()
