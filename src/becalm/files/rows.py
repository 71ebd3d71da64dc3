"""Tables that may be larger than memory: their rows are read in blocks, as often as needed."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import IO, Any, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.errors import OutputError

BLOCK_ROWS = 1 << 20  # most rows of a block
BLOCK_BYTES = 64 << 20  # most bytes of a block, with 8 bytes per value
MOST_MEMORY_ROWS = 1 << 24
"""The most rows of a single column that are kept in memory; a longer column is written to a temporary file."""

_SPOOL_BLOCK = 1 << 16  # numbers that `Spool.blocks` yields at a time

NumberArray = NDArray[Any]  # float64 or int64


class TableRows(Protocol):
    """The interface of a table in memory, in a Parquet file, in a temporary file or elsewhere."""

    @property
    def schema(self) -> pa.Schema:
        """The names of the columns, all different, and their types."""

    @property
    def count(self) -> int:
        """The number of rows."""

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Yield the named columns from row `start` on, in blocks of up to `most_rows`, none of them empty."""

    def close(self) -> None:
        """Release files and memory."""


def block_rows(schema: pa.Schema) -> int:
    """Return the number of rows of a block: up to a million, and up to 64 MiB at 8 bytes per value."""
    return max(1, min(BLOCK_ROWS, BLOCK_BYTES // (8 * max(1, len(schema)))))


class MemoryRows:
    """A table in memory."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table
        self.schema: pa.Schema = table.schema
        self.count: int = table.num_rows

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Yield slices of the table."""
        table = self._table.select(list(names))
        for first in range(start, self.count, most_rows):
            yield table.slice(first, most_rows)

    def close(self) -> None:
        """Do nothing: memory is released with the table."""


class SpooledRows:
    """A table in a temporary file, which disappears when the process ends.

    Parameters
    ----------
    schema : pyarrow.Schema
        The schema of the tables that `add` takes.

    Attributes
    ----------
    count : int
        Number of rows so far.
    missing : list of int
        Number of null cells so far in each column of these tables.
    """

    def __init__(self, schema: pa.Schema) -> None:
        self.schema = schema
        self._written: list[str] = schema.names
        self.count = 0
        self.missing = [0] * len(schema)
        self._ends: list[int] = []
        with _full_disk_explained():
            self._file: IO[bytes] = tempfile.TemporaryFile(prefix="becalm.")  # noqa: SIM115  (`close` closes it)
        self._writer = pa.ipc.new_file(pa.PythonFile(self._file, "w"), schema)
        self._input: pa.PythonFile | None = None

    def add(self, table: pa.Table) -> None:
        """Append the next rows."""
        for batch in table.combine_chunks().to_batches():
            with _full_disk_explained():
                self._writer.write_batch(batch)
            self.count += batch.num_rows
            self._ends.append(self.count)
        for position, column in enumerate(table.columns):
            self.missing[position] += column.null_count

    def keep(self, names: Sequence[str]) -> None:
        """Keep only the named columns in the schema."""
        fields = [self.schema.field(name) for name in names]
        self.schema = pa.schema(fields, metadata=self.schema.metadata)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Yield the named columns from row `start` on, in blocks of up to `most_rows`."""
        reader, schema = self._reader(names), pa.schema(map(self.schema.field, names), self.schema.metadata)
        for number, end in enumerate(self._ends):
            if end <= start:
                continue
            batch = reader.get_batch(number)
            first = max(0, start - (end - batch.num_rows))
            table = pa.table(pa.Table.from_batches([batch]).select(list(names)).columns, schema=schema)
            for at in range(first, batch.num_rows, most_rows):
                yield table.slice(at, most_rows)

    def _reader(self, names: Sequence[str]) -> pa.ipc.RecordBatchFileReader:
        """Return a reader of the named columns; after the first call, no rows can be added."""
        if self._input is None:
            with _full_disk_explained():
                self._writer.close()
                self._file.flush()
            self._input = pa.PythonFile(self._file, "r")
        wanted = [position for position, name in enumerate(self._written) if name in names]
        return pa.ipc.open_file(self._input, options=pa.ipc.IpcReadOptions(included_fields=wanted))

    def close(self) -> None:
        """Close the temporary file, which removes it."""
        self._file.close()


class RowsWithTime:
    """Rows with a column of time in seconds at an even rate: a new first column, or in the place of the old times."""

    def __init__(self, rows: TableRows, name: str, rate_hz: float) -> None:
        self._rows, self._name, self._step_s = rows, name, 1 / rate_hz
        new = name not in rows.schema.names
        self.schema: pa.Schema = rows.schema.insert(0, pa.field(name, pa.float64())) if new else rows.schema
        self.count = rows.count

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Yield the named columns from row `start` on, in blocks of up to `most_rows`."""
        stored = [name for name in names if name != self._name] or self._rows.schema.names[:1]
        schema = pa.schema(map(self.schema.field, names), self.schema.metadata)
        for block in self._rows.blocks(stored, most_rows, start):
            seconds = pa.array(np.arange(start, start + block.num_rows) * self._step_s)
            columns = [seconds if name == self._name else block.column(name) for name in names]
            yield pa.table(columns, schema=schema)
            start += block.num_rows

    def close(self) -> None:
        """Close the rows of the file."""
        self._rows.close()


@contextmanager
def _full_disk_explained() -> Iterator[None]:
    """Turn an OSError while a temporary file is written into an OutputError that says what to do."""
    try:
        yield
    except OSError as cause:
        raise OutputError(
            f"The folder for temporary files, {tempfile.gettempdir()}, has not enough space for a recording of this"
            f" length ({cause.strerror or cause}). Make room, or choose another folder: TMPDIR=FOLDER becalm ..."
        ) from cause


def rebatched(blocks: Iterable[pa.Table], rows: int) -> Iterator[pa.Table]:
    """Yield the same rows in blocks of exactly `rows` rows; the last block may be shorter."""
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
    """A column of numbers, in memory or, if it is longer than `MOST_MEMORY_ROWS`, in a temporary file.

    Parameters
    ----------
    blocks : iterable of (n,) arrays
        The numbers in order; all blocks are float64, or all are int64.
    count : int
        How many numbers there are in all blocks.
    """

    def __init__(self, blocks: Iterable[NumberArray], count: int) -> None:
        self._file: IO[bytes] | None = None
        self._held: NumberArray = np.empty(0)
        self.count = count
        if count <= MOST_MEMORY_ROWS:
            at = 0
            for block in blocks:
                if not at:
                    self._held = np.empty(count, block.dtype)
                self._held[at : at + len(block)] = block
                at += len(block)
            return
        with _full_disk_explained():
            self._file = tempfile.TemporaryFile(prefix="becalm.")  # noqa: SIM115  (`close` closes it)
        try:
            for block in blocks:
                self._held = np.empty(0, block.dtype)
                with _full_disk_explained():
                    self._file.write(np.ascontiguousarray(block).data)
                    self._file.flush()
        except BaseException:
            self._file.close()
            raise

    def read(self, start: int, stop: int) -> NumberArray:
        """Return the numbers from row `start` up to row `stop`."""
        if self._file is None:
            return self._held[start:stop]
        out = np.empty(max(0, min(stop, self.count) - start), self._held.dtype)
        self._file.seek(start * out.itemsize)
        self._file.readinto(out.data.cast("B"))  # type: ignore[attr-defined]  # buffered files have readinto
        return out

    def blocks(self) -> Iterator[NumberArray]:
        """Yield all numbers in small blocks."""
        for start in range(0, self.count, _SPOOL_BLOCK):
            yield self.read(start, start + _SPOOL_BLOCK)

    def close(self) -> None:
        """Close the temporary file, if any, which removes it."""
        if self._file is not None:
            self._file.close()
