"""Write tables to Parquet in large row groups, with dictionaries only for columns of repeated values."""

from __future__ import annotations

from contextlib import suppress
from typing import IO, Any

import numpy as np
import pyarrow as pa

_GROUP_ROWS = 1 << 20  # rows of a row group
_GROUP_BYTES = 256 << 20  # bytes of held rows that are written as a row group even if there are fewer rows
_SAMPLED = 4096  # values of a column that decide whether it gets a dictionary


class ParquetTableWriter:
    """A writer that appends tables of one schema to a Parquet file.

    Parameters
    ----------
    file : binary file
        The output; it is not closed.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._writer: Any = None
        self._held: list[pa.Table] = []
        self._rows = self._bytes = 0

    def write(self, table: pa.Table) -> None:
        """Write some rows, or hold them until they fill a row group."""
        if self._writer is None:
            self._writer = _new_writer(self._file, table)
        self._held.append(table)
        self._rows += table.num_rows
        self._bytes += table.nbytes
        if self._rows >= _GROUP_ROWS or self._bytes >= _GROUP_BYTES:
            self._flush()

    def close(self) -> None:
        """Write the held rows and the end of the Parquet file; the file stays open."""
        if self._writer is not None:
            self._flush()
            self._writer.close()

    def drop(self) -> None:
        """Discard the held rows and close the Parquet writer."""
        self._held = []
        if self._writer is not None and self._writer.is_open:
            with suppress(OSError, pa.ArrowException):
                self._writer.close()
            self._writer.is_open = False  # otherwise its destructor would try to close it again

    def _flush(self) -> None:
        if self._held:
            self._writer.write_table(pa.concat_tables(self._held), row_group_size=_GROUP_ROWS)
        self._held, self._rows, self._bytes = [], 0, 0


def _new_writer(file: IO[bytes], table: pa.Table) -> Any:
    import pyarrow.parquet as pq

    nested = any(pa.types.is_nested(field.type) for field in table.schema)
    repeating = [name for name in table.column_names if _repeats(table.column(name))]
    return pq.ParquetWriter(file, table.schema, use_dictionary=True if nested else repeating)


def _repeats(column: pa.ChunkedArray) -> bool:
    """Return whether a column gets a dictionary; a long column of floats gets none if few values in a sample repeat.

    The sigma of a steady state repeats, but a clean signal does not.
    """
    if not pa.types.is_floating(column.type) or len(column) < _SAMPLED:
        return True
    sample = column.take(np.linspace(0, len(column) - 1, _SAMPLED).astype(np.int64)).to_numpy()
    return len(np.unique(sample)) * 2 < _SAMPLED
