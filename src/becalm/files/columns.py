"""Rows of a file that is read column by column, as instruments write them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.files.library_reader import Foreign

NO_UNIT = "-"
"""Of a column whose name holds no unit either: `range_min` is no range in minutes where a format names its fields."""


class Column(NamedTuple):
    """One column of a file.

    Attributes
    ----------
    type : pyarrow.DataType
        Of its values.
    read : callable
        Gives the values of the rows from `start` up to `stop`, (stop - start,), in units of the file.
    unit : str
        As the file has it, "" where it does not say.
    """

    type: pa.DataType
    read: Callable[[int, int], NDArray[np.generic]]
    unit: str = ""

    @classmethod
    def of(cls, values: NDArray[np.generic], unit: str = "") -> Column:
        """Return a column whose values (N,) are in memory."""
        return cls(pa.from_numpy_dtype(values.dtype), lambda start, stop: values[start:stop], unit)


class ColumnRows:
    """The rows of columns that are read when they are asked for.

    Parameters
    ----------
    columns : mapping of str to Column
        By their names, in the order of the file.
    count : int
        How many rows each of them has.
    foreign : Foreign
        Says what went wrong while they are read.
    close : callable, optional
        Gives back what is held.
    metadata : mapping of str to str, optional
        Of the table, which whatever is written of it keeps.
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
        """Read the named columns from row `start` on, in blocks of up to `most_rows`."""
        schema = pa.schema([self.schema.field(name) for name in names], self.schema.metadata)
        for first in range(start, self.count, most_rows):
            last = min(first + most_rows, self.count)
            with self._foreign.damage_told():
                values = [self._columns[name].read(first, last) for name in names]
                arrays = [pa.array(one, kind) for one, kind in zip(values, schema.types, strict=True)]
            yield pa.table(arrays, schema=schema)

    def close(self) -> None:
        """Give back what is held."""
        if self._close is not None:
            self._close()


def least_bytes(kind: pa.DataType) -> int:
    """Return how many bytes a value takes at least: numbers, flags and times as many as they have, all else 1."""
    return kind.bit_width // 8 if pa.types.is_primitive(kind) else 1


def _field(name: str, column: Column) -> pa.Field:
    return pa.field(name, column.type, metadata={b"unit": column.unit.encode()} if column.unit else None)
