"""Read tables whose columns are stored one by one, as the formats of instruments do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.files.library_reader import Foreign

NO_UNIT = "-"
"""The unit of a column that has none, not even in its name.

In a format with named fields, `range_min` is the lowest range and not a range in minutes.
"""


class Column(NamedTuple):
    """One column of a file.

    Attributes
    ----------
    type : pyarrow.DataType
        The type of its values.
    read : callable
        Returns the values of the rows from `start` up to `stop`, (stop - start,), in the unit of the file.
    unit : str
        The unit as the file writes it, "" if the file has none.
    """

    type: pa.DataType
    read: Callable[[int, int], NDArray[np.generic]]
    unit: str = ""

    @classmethod
    def of(cls, values: NDArray[np.generic], unit: str = "") -> Column:
        """Return a column whose values (N,) are in memory."""
        return cls(pa.from_numpy_dtype(values.dtype), lambda start, stop: values[start:stop], unit)


class ColumnRows:
    """The rows of a table whose columns are read on demand.

    Parameters
    ----------
    columns : mapping of str to Column
        Columns by name, in the order of the file.
    count : int
        Number of rows of each column.
    foreign : Foreign
        The file; turns errors during reading into messages.
    close : callable, optional
        Called by `close`, to release the file.
    metadata : mapping of str to str, optional
        Metadata of the table; outputs keep it.
    """

    def __init__(
        self,
        columns: Mapping[str, Column],
        count: int,
        foreign: Foreign,
        close: Callable[[], None] | None = None,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        self._columns, self.count, self._foreign, self._close = dict(columns), count, foreign, close
        self.schema: pa.Schema = pa.schema([_field(name, column) for name, column in columns.items()], metadata or None)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Yield the named columns from row `start` on, in blocks of up to `most_rows`."""
        schema = pa.schema([self.schema.field(name) for name in names], self.schema.metadata)
        for first in range(start, self.count, most_rows):
            last = min(first + most_rows, self.count)
            with self._foreign.explain_damage():
                values = [self._columns[name].read(first, last) for name in names]
                arrays = [pa.array(one, kind) for one, kind in zip(values, schema.types, strict=True)]
            yield pa.table(arrays, schema=schema)

    def close(self) -> None:
        """Release the file."""
        if self._close is not None:
            self._close()


def least_bytes(kind: pa.DataType) -> int:
    """Return the least number of bytes of a value: the width of a number, flag or time; 1 for any other type."""
    return kind.bit_width // 8 if pa.types.is_primitive(kind) else 1


def _field(name: str, column: Column) -> pa.Field:
    return pa.field(name, column.type, metadata={b"unit": column.unit.encode()} if column.unit else None)
