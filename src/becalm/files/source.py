"""What was found in a file, and how it was understood."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import pyarrow as pa

from becalm.core.recording import Recording
from becalm.core.time.clock import Clock
from becalm.files.identity import Original
from becalm.files.rows import TableRows, block_rows, rebatched
from becalm.sensors.record import Calibration

TIME = "time"
CHANNEL = "channel"
PASSED = "passed through"
HEAD_ROWS = 200


@dataclass(frozen=True)
class TextLayout:
    """How a text file is written.

    Attributes
    ----------
    encoding : str
        "utf-8", "utf-8-bom", "utf-16-le", "utf-16-be" or "cp1252".
    compression : str
        "gzip" or "".
    separator : str
        Between two cells; " " stands for runs of spaces, "" for a file of one column.
    decimal : str
        "." or ",".
    header_rows : int
        Rows of names and units above the data.
    skipped_rows : int
        Lines above the header that are no part of the table.
    first_line : int
        Line of the first row of data, counted from 1.
    """

    encoding: str
    compression: str
    separator: str
    decimal: str
    header_rows: int
    skipped_rows: int
    first_line: int


class ToldTime(NamedTuple):
    """The time of rows, where the format itself tells it.

    Attributes
    ----------
    column : str
        The column that holds it, in seconds; "" before it has one.
    rate_hz : float or None
        Of rows that are even, which counts more than the column.
    start : str
        The first instant as ISO 8601 text; "" where the file does not tell.
    """

    column: str = ""
    rate_hz: float | None = None
    start: str = ""


@dataclass(frozen=True)
class RawTable:
    """Columns as they are in the file, before anyone asked what they mean.

    Attributes
    ----------
    rows : TableRows
        Numbers as numbers, all else as it was; names are all different.
    count : int
        How many of the rows count: blank ones at the end of a text file do not.
    format : str
        "csv", "parquet", "mf4" and so on.
    units : dict of str to str
        Units that the file gives apart from the names (a row of units, field metadata).
    text : TextLayout, optional
        How the text was written, for text files.
    original : Original, optional
        The file as it was when reading began, if it can be read again.
    group : str
        What the file calls these columns, which share one time; "" where all of them do.
    time : ToldTime, optional
        Where the format itself tells which time it is.
    notes : tuple of str
        What a person must know, as sentences: that the file is incomplete, or was mended.
    calibrations : dict of str to Calibration
        Of columns that sensors turned into their units.
    joined : str
        Of which files the rows are, as a sentence for whoever must look for a stamp in them; "" where it is one.
    """

    rows: TableRows
    count: int
    format: str
    units: dict[str, str] = field(default_factory=dict)
    text: TextLayout | None = None
    original: Original | None = None
    group: str = ""
    time: ToldTime | None = None
    notes: tuple[str, ...] = ()
    calibrations: dict[str, Calibration] = field(default_factory=dict)
    joined: str = ""

    @property
    def names(self) -> list[str]:
        """The columns in the order of the file."""
        return list(self.rows.schema.names)

    @property
    def decimal(self) -> str:
        """The decimal sign of numbers in text."""
        return self.text.decimal if self.text else "."

    @cached_property
    def head(self) -> pa.Table:
        """The first rows of all columns: enough to see what they hold."""
        blocks = rebatched(self.blocks(self.names, most_rows=HEAD_ROWS), HEAD_ROWS)
        return next(blocks, self.rows.schema.empty_table())

    def type_of(self, name: str) -> pa.DataType:
        """Return the type of a column."""
        return self.rows.schema.field(name).type

    def blocks(self, names: Sequence[str], start: int = 0, most_rows: int | None = None) -> Iterator[pa.Table]:
        """Give columns in blocks from row `start` on, in the order asked."""
        left = self.count - start
        for block in self.rows.blocks(names, most_rows or block_rows(self.rows.schema), start):
            if left <= 0:
                return
            yield block.slice(0, left)
            left -= block.num_rows

    def column(self, name: str) -> Iterator[pa.ChunkedArray]:
        """Give one column in blocks."""
        return (block.column(0) for block in self.blocks([name]))

    def place(self, row: int) -> str:
        """Say where a row of data is, counted from 0, for a person who opens the file."""
        if self.text is None:
            return f"row {row + 1}"
        return f"row {row + 1} (line {self.text.first_line + row})"


@dataclass(frozen=True)
class TimeLayout:
    """How time was read.

    Attributes
    ----------
    columns : tuple of str
        The time column; two where a date and a time of day stand apart; none where rows were counted.
    kind : str
        "numbers", "epoch", "date-time", "time of day", "duration" or "counted rows".
    unit : str
        Unit of the numbers; "" where the kind says it all.
    start : str
        The first instant as ISO 8601 text where the file gives a date; "" otherwise.
    notes : tuple of str
        What was mended, as sentences.
    """

    columns: tuple[str, ...]
    kind: str
    unit: str = ""
    start: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ColumnLayout:
    """What a column was taken for, and why; `missing` counts its empty cells, None before anyone counted."""

    name: str
    role: str
    why: str
    unit: str
    missing: int | None = None


@dataclass(frozen=True)
class Layout:
    """How a file was understood; what `becalm inspect` shows.

    `separator`, `decimal`, `encoding` and `compression` are "" and the rows above the data 0 where
    the format has no such thing. `gaps` and `repeats` count rows; `notes` are sentences for a person.
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
    """A file that was read.

    Attributes
    ----------
    recording : Recording
        The chosen channels as float64, NaN where a cell is missing; names as in the header.
    table : pyarrow.Table
        All columns in the order of the file, as they are to be passed through.
    layout : Layout
        How the file was understood.
    """

    recording: Recording
    table: pa.Table
    layout: Layout


def layout_of(raw: RawTable, time: TimeLayout, clock: Clock, columns: tuple[ColumnLayout, ...]) -> Layout:
    """Put together what the rooms' readers found."""
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
        jitter_s=float(clock.jitter_s),  # plain: comparing NumPy's with a list makes an array
        duration_s=clock.duration_s,
        gaps=clock.gaps,
        repeats=clock.repeats,
        columns=columns,
    )
