"""Recognise times, counters, flags and signals block by block; read tables whose columns are stored one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.core.arrays import Floats
from becalm.core.time.clock import Thinned
from becalm.files.library_reader import LibraryFile

_EXACT = 2.0**53  # float64 represents every whole number up to this one


class ColumnStatistics:
    """Statistics of a column that may be a time: first values, direction, and a sample of values and steps.

    Parameters
    ----------
    count : int
        How many values the column has.

    Attributes
    ----------
    first, first_known : float
        The first value, and the first finite value; NaN if there is none.
    rises : bool
        Whether every value is greater than the previous one.
    falls : bool
        Whether any value is less than the previous one.
    whole : bool
        Whether all finite steps are whole numbers.
    """

    def __init__(self, count: int) -> None:
        self._values, self._steps = Thinned(count), Thinned(max(0, count - 1))
        self._last: float | None = None
        self._counter = Counter()
        self.first = self.first_known = np.nan
        self.rises, self.falls, self.whole = True, False, True

    def add(self, values: Floats) -> None:
        """Add the next values, NaN where one is missing."""
        steps = differences(values, self._last)
        if self._last is None:
            self.first = float(values[0])
        if np.isnan(self.first_known) and np.isfinite(values).any():
            self.first_known = float(values[np.isfinite(values)][0])
        self._last = float(values[-1])
        self._values.add(values)
        self._steps.add(steps)
        self._counter.add(values, steps)
        self.rises = self.rises and bool(np.all(steps > 0))
        self.falls = self.falls or (not self.rises and bool(np.any(steps < 0)))
        if self.whole:
            finite = steps if self.rises else steps[np.isfinite(steps)]
            self.whole = bool(np.all(finite == np.round(finite)))

    @property
    def counts(self) -> bool:
        """Return whether the values are whole numbers in steps of exactly 1."""
        return self._counter.counts

    @property
    def values(self) -> Floats:
        """Return the finite values, (n,); beyond a million rows, those in evenly spaced runs of a thousand rows."""
        values = self._values.values
        return values[np.isfinite(values)]

    @property
    def steps(self) -> Floats:
        """Return the finite steps, (n,); beyond a million rows, those in evenly spaced runs of a thousand rows."""
        steps = self._steps.values
        return steps[np.isfinite(steps)]


class Counter:
    """A detector of columns that count rows: whole numbers in steps of exactly 1."""

    def __init__(self) -> None:
        self._seen = 0
        self._possible = True

    def add(self, values: Floats, steps: Floats) -> None:
        """Add the next values, and the step from each previous value."""
        if not self._seen:
            self._possible = bool(values[0] == np.round(values[0]))
        self._seen += len(values)
        self._possible = self._possible and bool(np.all(steps == 1.0))

    @property
    def possible(self) -> bool:
        """Return whether the values so far may be the beginning of a counter."""
        return self._possible

    @property
    def counts(self) -> bool:
        """Return whether the values so far are a counter; False for fewer than three values."""
        return self._possible and self._seen > 2


class ChannelTest:
    """A test whether a column is a channel: not a counter, not a flag, and exact in float64.

    Parameters
    ----------
    integer : bool
        Whether the file stores the column as whole numbers.
    """

    def __init__(self, integer: bool) -> None:
        self._integer = integer
        self._last: float | None = None
        self._counter = Counter()
        self._zeros = self._ones = False
        self._only_flags = True
        self._largest = 0.0

    def add(self, values: Floats) -> None:
        """Add the next values, NaN where one is missing."""
        if self._counter.possible:
            self._counter.add(values, differences(values, self._last))
            self._last = float(values[-1])
        if self._only_flags:
            zeros, ones = values == 0.0, values == 1.0
            self._zeros, self._ones = self._zeros or bool(zeros.any()), self._ones or bool(ones.any())
            self._only_flags = bool(np.all(zeros | ones | np.isnan(values)))
        if self._integer:
            self._largest = max(self._largest, float(np.abs(values).max(initial=0.0, where=np.isfinite(values))))

    @property
    def decided(self) -> bool:
        """Return whether later values can no longer change the decision."""
        return self._largest > _EXACT or not (self._integer or self._counter.possible or self._only_flags)

    @property
    def why_not_channel(self) -> str:
        """Return why the column is not a channel; "" if it is one."""
        if self._largest > _EXACT:
            return "whole numbers beyond 2^53, which float64 cannot distinguish"
        if self._counter.counts:
            return "a counter (steps of exactly 1)"
        return "a flag (only 0 and 1)" if self._only_flags and self._zeros and self._ones else ""


def differences(values: Floats, last: float | None) -> Floats:
    """Return each value minus the one before it, NaN if either is missing; `last` is the value before the first."""
    with np.errstate(invalid="ignore"):
        return np.diff(values) if last is None else np.diff(values, prepend=last)


# Read tables whose columns are stored one by one, as in the formats of instruments.

NO_UNIT = "-"
"""The unit of a column without a unit, in a format whose names contain no units.

For example, the field `range_min` is a lowest range and not a range in minutes.
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
    library_file : LibraryFile
        The file; turns errors during reading into messages.
    close : callable, optional
        Releases the file; called by `close`.
    metadata : mapping of str to str, optional
        Metadata of the table; outputs keep it.
    """

    def __init__(
        self,
        columns: Mapping[str, Column],
        count: int,
        library_file: LibraryFile,
        close: Callable[[], None] | None = None,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        self._columns, self.count, self._library_file, self._close = dict(columns), count, library_file, close
        self.schema: pa.Schema = pa.schema([_field(name, column) for name, column in columns.items()], metadata or None)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Yield the named columns from row `start` on, in blocks of up to `most_rows`."""
        schema = pa.schema([self.schema.field(name) for name in names], self.schema.metadata)
        for first in range(start, self.count, most_rows):
            last = min(first + most_rows, self.count)
            with self._library_file.explain_damage():
                values = [self._columns[name].read(first, last) for name in names]
                arrays = [pa.array(one, kind) for one, kind in zip(values, schema.types, strict=True)]
            yield pa.table(arrays, schema=schema)

    def close(self) -> None:
        """Release the file."""
        if self._close is not None:
            self._close()


def least_bytes(kind: pa.DataType) -> int:
    """Return the least number of bytes of a value: the width of a number or time, 0 for a flag (a bit), otherwise 1."""
    return kind.bit_width // 8 if pa.types.is_primitive(kind) else 1


def _field(name: str, column: Column) -> pa.Field:
    return pa.field(name, column.type, metadata={b"unit": column.unit.encode()} if column.unit else None)
