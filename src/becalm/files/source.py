"""The tables of a file, and the description of how they were interpreted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import pyarrow as pa

from becalm.core.recording import Recording
from becalm.core.time.clock import Clock
from becalm.files.decoding import Original
from becalm.files.rows import TableRows, block_rows, rebatched

if TYPE_CHECKING:
    from becalm.sensors.record import Calibration

TIME = "time"
CHANNEL = "channel"
PASSED_THROUGH = "passed through"
"""The roles of columns."""

HEAD_ROWS = 200  # rows of `RawTable.head`


@dataclass(frozen=True)
class TextLayout:
    """The layout of a text file.

    Attributes
    ----------
    encoding : str
        "utf-8", "utf-8-bom", "utf-16-le", "utf-16-be" or "cp1252".
    compression : str
        "gzip" or "".
    separator : str
        The character between two cells; " " stands for runs of spaces, "" for a file of one column.
    decimal : str
        The decimal separator, "." or ",".
    header_rows : int
        Number of rows of names and units above the data.
    skipped_rows : int
        Number of lines above the header that are not part of the table.
    first_line : int
        Line number of the first row of data, counted from 1.
    """

    encoding: str
    compression: str
    separator: str
    decimal: str
    header_rows: int
    skipped_rows: int
    first_line: int


class FormatTime(NamedTuple):
    """The time of rows as the format defines it.

    Attributes
    ----------
    column : str
        Name of the column that holds the time in seconds; "" until such a column is added.
    rate_hz : float or None
        The rate in Hz of evenly spaced rows; it takes precedence over the column.
    start : str
        The first instant as ISO 8601 text; "" if the file does not give it.
    """

    column: str = ""
    rate_hz: float | None = None
    start: str = ""


@dataclass(frozen=True)
class RawTable:
    """The columns of a file with one time base, before time and channels are chosen among them.

    Attributes
    ----------
    rows : TableRows
        The rows; numbers as numbers, all other cells as in the file. Column names are all different.
    count : int
        Number of rows, without blank rows at the end of a text file.
    format : str
        "csv", "parquet", "mf4" and so on.
    units : dict of str to str
        Units that the file gives separately from the names (a row of units, field metadata), by column name.
    text : TextLayout, optional
        The layout of a text file.
    original : Original, optional
        The state of the file when reading began; None for a pipe, which cannot be read again.
    group : str
        The name of the time base in the file; "" if all columns of the file share one time.
    time : FormatTime, optional
        The time, if the format defines it.
    notes : tuple of str
        Sentences for the user, such as that the file is incomplete or was repaired.
    calibrations : dict of str to Calibration
        Calibrations of columns that were converted from a sensor's raw readings, by column name.
    joined : str
        A sentence that names the files the rows come from, for messages about time stamps; "" for a single file.
    """

    rows: TableRows
    count: int
    format: str
    units: dict[str, str] = field(default_factory=dict)
    text: TextLayout | None = None
    original: Original | None = None
    group: str = ""
    time: FormatTime | None = None
    notes: tuple[str, ...] = ()
    calibrations: dict[str, Calibration] = field(default_factory=dict)
    joined: str = ""

    @property
    def names(self) -> list[str]:
        """Return the names of the columns, in the order of the file."""
        return list(self.rows.schema.names)

    @property
    def decimal(self) -> str:
        """Return the decimal separator of numbers in text."""
        return self.text.decimal if self.text else "."

    @cached_property
    def head(self) -> pa.Table:
        """Return the first rows of all columns, at most 200; they show the kind of each column."""
        blocks = rebatched(self.blocks(self.names, most_rows=HEAD_ROWS), HEAD_ROWS)
        return next(blocks, self.rows.schema.empty_table())

    def type_of(self, name: str) -> pa.DataType:
        """Return the type of a column."""
        return self.rows.schema.field(name).type

    def blocks(self, names: Sequence[str], start: int = 0, most_rows: int | None = None) -> Iterator[pa.Table]:
        """Yield the named columns in blocks of up to `most_rows`, from row `start` to row `count` - 1."""
        left = self.count - start
        for block in self.rows.blocks(names, most_rows or block_rows(self.rows.schema), start):
            if left <= 0:
                return
            yield block.slice(0, left)
            left -= block.num_rows

    def column(self, name: str) -> Iterator[pa.ChunkedArray]:
        """Yield one column in blocks."""
        return (block.column(0) for block in self.blocks([name]))

    def place(self, row: int) -> str:
        """Return the place of row `row`, counted from 0, in words for the user, such as "row 3 (line 5)"."""
        if self.text is None:
            return f"row {row + 1}"
        return f"row {row + 1} (line {self.text.first_line + row})"


@dataclass(frozen=True)
class TimeLayout:
    """How the time of a file was read.

    Attributes
    ----------
    columns : tuple of str
        The time column; two if date and time of day are separate columns; none if rows are counted.
    kind : str
        "numbers", "epoch", "date-time", "date", "time of day", "duration", "rate in the file" or "counted rows".
    unit : str
        Unit of the numbers; "" for kinds that have no unit.
    start : str
        The first instant as ISO 8601 text if the file gives a date; "" otherwise.
    notes : tuple of str
        Sentences for the user about corrections of the time.
    """

    columns: tuple[str, ...]
    kind: str
    unit: str = ""
    start: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ColumnLayout:
    """The role of a column and the reason for it; `missing` is its number of empty cells, None if not counted yet."""

    name: str
    role: str
    why: str
    unit: str
    missing: int | None = None


@dataclass(frozen=True)
class Layout:
    """How a file was interpreted; `becalm inspect` shows it.

    For formats other than text, `separator`, `decimal`, `encoding` and `compression` are "", and `header_rows` and
    `skipped_rows` are 0. `gaps` and `repeats` count rows; `notes` are sentences for the user.
    """

    format: str
    group: str
    notes: tuple[str, ...]
    rows: int
    encoding: str
    compression: str
    separator: str
    decimal: str
    header_rows: int
    skipped_rows: int
    time_columns: tuple[str, ...]
    time_kind: str
    time_unit: str
    time_start: str
    rate_hz: float
    uniform: bool
    jitter_s: float
    duration_s: float
    gaps: int
    repeats: int
    columns: tuple[ColumnLayout, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        plain = asdict(self)
        plain |= {"time_columns": list(self.time_columns), "notes": list(self.notes)}
        plain["columns"] = [asdict(column) for column in self.columns]
        return plain


@dataclass(frozen=True)
class SourceFile:
    """A file that was read into memory.

    Attributes
    ----------
    recording : Recording
        The chosen channels as float64, NaN where a cell is missing; names as in the header.
    table : pyarrow.Table
        All columns in the order of the file, with their values unchanged.
    layout : Layout
        How the file was interpreted.
    """

    recording: Recording
    table: pa.Table
    layout: Layout


def layout_of(raw: RawTable, time: TimeLayout, clock: Clock, columns: tuple[ColumnLayout, ...]) -> Layout:
    """Combine the results of reading a file into its layout."""
    text = raw.text or TextLayout("", "", "", "", 0, 0, 1)
    return Layout(
        format=raw.format,
        group=raw.group,
        notes=(*raw.notes, *time.notes),
        rows=raw.count,
        encoding=text.encoding,
        compression=text.compression,
        separator=text.separator,
        decimal=text.decimal,
        header_rows=text.header_rows,
        skipped_rows=text.skipped_rows,
        time_columns=time.columns,
        time_kind=time.kind,
        time_unit=time.unit,
        time_start=time.start,
        rate_hz=clock.rate_hz,
        uniform=clock.uniform,
        jitter_s=float(clock.jitter_s),  # a Python float, because comparing a NumPy float with a list returns an array
        duration_s=clock.duration_s,
        gaps=clock.gaps,
        repeats=clock.repeats,
        columns=columns,
    )


def shared_closers(tables: int, close: Callable[[], None] | None) -> list[Callable[[], None]]:
    """Return a function for each table of a file, to call when the table is closed; the last call closes the file.

    A second call of a function does nothing.

    Parameters
    ----------
    tables : int
        Number of tables that share the file.
    close : callable or None
        Closes the file; None if there is nothing to close.
    """
    still_open = set(range(tables))

    def close_table(table: int) -> None:
        if table in still_open:
            still_open.remove(table)
            if not still_open and close is not None:
                close()

    return [partial(close_table, table) for table in range(tables)]
