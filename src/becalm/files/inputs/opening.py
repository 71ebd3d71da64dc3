"""Open a recording of any length: find its time and its channels, then read it in chunks."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.core.time.clock import Clock
from becalm.core.time.timebase import Timebase
from becalm.errors import InputError, TimeError
from becalm.files.groups import chosen_table
from becalm.files.other_units import convert_units
from becalm.files.read_options import ReadOptions, refuse_impossible
from becalm.files.registry import read_tables
from becalm.files.roles import SIGMA, choose_channels, missing_in, refuse_uncertainties, unit_of, values_of
from becalm.files.rows import MemoryRows, block_rows, rebatched
from becalm.files.source import Layout, RawTable, SourceFile, TimeLayout, layout_of
from becalm.files.timing.clock import clock_of
from becalm.files.timing.times import Stamps, row_times

if TYPE_CHECKING:
    from becalm.sensors.record import Calibration


@dataclass(frozen=True)
class Chunk:
    """A chunk of consecutive rows of a file.

    Attributes
    ----------
    first_row : int
        The first row of the chunk, counted from 0 at the start of the file.
    table : pyarrow.Table
        All columns in the order of the file, with their values unchanged.
    elapsed_steps : (n,) float array
        Time since the previous row, in steps of the clock; 0 for the first row of the file.
    names : tuple of str
        The channels.
    decimal : str
        The decimal separator of numbers in text.
    """

    first_row: int
    table: pa.Table
    elapsed_steps: Floats
    names: tuple[str, ...]
    decimal: str = "."

    def __len__(self) -> int:
        """Return the number of rows."""
        return int(self.table.num_rows)

    def channel(self, number: int) -> Floats:
        """Return one channel, (n,), NaN where a cell is missing; read-only where it shares memory with the table."""
        return values_of(self.table.column(self.names[number]), self.decimal)

    @property
    def samples(self) -> Floats:
        """Return all channels, (n, m), NaN where a cell is missing."""
        out = np.empty((len(self), len(self.names)))
        for number in range(len(self.names)):
            out[:, number] = self.channel(number)
        return out


STRETCHES = 8
"""Number of stretches, each of consecutive rows, in a sample of a long recording."""


class OpenSource:
    """An open recording with its time and channels; made by `open_source`, to be closed after use.

    Attributes
    ----------
    path : Path
        The file.
    names, units : tuple of str
        The channels to clean, and their units.
    clock : Clock
        Step, gaps and jitter of its time.
    columns : tuple of ColumnLayout
        The role of each column. Missing cells are not counted here; `layout` counts them.
    rows : int
        Number of rows.
    schema : pyarrow.Schema
        The schema of the tables of its chunks.
    """

    def __init__(self, path: Path, raw: RawTable, options: ReadOptions) -> None:
        self.path, self._raw = path, raw
        self._stamps: Stamps | None = None
        self._time = TimeLayout((), "counted rows")
        try:
            self._interpret(raw, options)
        except BaseException:
            self.close()
            raise

    def _interpret(self, raw: RawTable, options: ReadOptions) -> None:
        if raw.count == 0:
            raise InputError("It has columns but no rows; two or more rows are needed.")
        times = row_times(raw, options)
        self._raw, self._stamps, self._time, raw = times.raw, times.stamps, times.layout, times.raw
        self.names, self.columns = choose_channels(
            raw, self._time.columns, times.candidates, options.channels, options.origin
        )
        refuse_uncertainties(self.names)
        self.units = tuple(unit_of(raw, name) for name in self.names)
        self.rows: int = raw.count
        self.schema: pa.Schema = raw.rows.schema
        self.clock = Clock.counted(self.rows, times.rate_hz or 1.0)
        if self._stamps is not None:
            self.clock, self._time = clock_of(self._stamps, self._time, options.as_written)
            if self.clock.even:  # the time of a row follows from its number, so stamps are no longer needed
                self._stamps.close()
                self._stamps = None

    @cached_property
    def layout(self) -> Layout:
        """Return how the file was interpreted; this reads the whole file once, to count the missing cells."""
        counts = missing_in(self._raw)
        columns = tuple(replace(column, missing=count) for column, count in zip(self.columns, counts, strict=True))
        return layout_of(self._raw, self._time, self.clock, columns)

    @property
    def group(self) -> str:
        """Return the name of this time base in the file; "" if all channels of the file share one time."""
        return self._raw.group

    @property
    def calibrations(self) -> dict[str, Calibration]:
        """Return the calibrations of the channels that were converted from raw readings, by channel."""
        return self._raw.calibrations

    @property
    def start(self) -> str:
        """Return the first instant as ISO 8601 text; "" if the file gives no date."""
        return self._time.start

    @property
    def notes(self) -> tuple[str, ...]:
        """Return sentences for the user about the file."""
        return (*self._raw.notes, *self._time.notes)

    @property
    def replaced(self) -> tuple[str, ...]:
        """Return the columns NAME_sigma of the file that the output replaces by new uncertainties."""
        return tuple(name for name in self.schema.names if name in {own + SIGMA for own in self.names})

    @property
    def rate_hz(self) -> float:
        """Return the sample rate in Hz, 1 over the step."""
        return self.clock.rate_hz

    def chunks(self, rows: int | None = None, first: int = 0) -> Iterator[Chunk]:
        """Read the file chunk by chunk, from row `first` to the last; every call reads it again.

        Parameters
        ----------
        rows : int, optional
            Rows of each chunk but the last; by default about a million, fewer for many columns.
        first : int
            The row to begin with, counted from 0.

        Raises
        ------
        InputError
            If the file is damaged, or changes while it is read.
        """
        size = rows or block_rows(self.schema)
        row = first
        for table in rebatched(self._raw.blocks(self._raw.names, first, most_rows=size), size):
            yield Chunk(row, table, self.elapsed_steps(row, table.num_rows), self.names, self._raw.decimal)
            row += table.num_rows
        if self._raw.original is not None:
            self._raw.original.refuse_changed()

    def sha256(self) -> str:
        """Return the SHA-256 of the file, "" for a pipe, which cannot be read again.

        Raises
        ------
        InputError
            If the file changed since it was opened.
        """
        return "" if self._raw.original is None else self._raw.original.sha256()

    def elapsed_steps(self, first: int, count: int, before: int | None = None) -> Floats:
        """Return the time since the previous row in steps, (count,), for each row from `first` on; 0 for row 0.

        Parameters
        ----------
        first, count : int
            The rows, counted from 0.
        before : int, optional
            The row that precedes row `first` in the sequence; by default `first` - 1.
        """
        if self._stamps is None:
            return self.clock.elapsed_rows(first, count, before)
        if before is None and first > 0:
            before = first - 1
        last = None if before is None else float(self._stamps.read(before, before + 1)[0])
        return self.clock.elapsed(self._stamps.read(first, first + count), last)

    def seconds(self, first: int, count: int) -> Floats:
        """Return the times in seconds, (count,), of rows from `first` on: from stamps, or from an even clock."""
        if self._stamps is None:
            return self.clock.start_s + self.clock.step_s * np.arange(first, first + count, dtype=np.float64)
        return self._stamps.read(first, first + count)

    def recording(self) -> Recording:
        """Read the channels of the whole file into memory."""
        return self.stretches([(0, self.rows)])

    def sample(self, most_rows: int) -> Recording:
        """Read a sample of the channels for tuning: the whole file, or evenly spaced stretches with gaps in between.

        Parameters
        ----------
        most_rows : int
            The most rows of the sample.
        """
        if self.rows <= most_rows:
            return self.recording()
        count = min(STRETCHES, most_rows)
        length = most_rows // count
        starts = np.linspace(0, self.rows - length, count).astype(int).tolist()
        return self.stretches([(start, start + length) for start in starts])

    def stretches(self, parts: list[tuple[int, int]]) -> Recording:
        """Read stretches of rows as one recording; the time between two stretches becomes a gap.

        Parameters
        ----------
        parts : list of (int, int)
            First row and stop row of each stretch, in order.
        """
        samples = np.empty((sum(stop - start for start, stop in parts), len(self.names)))
        elapsed = [self.elapsed_steps(parts[0][0], parts[0][1] - parts[0][0], parts[0][0] or None)]
        for (_, before), (start, stop) in pairwise(parts):
            elapsed.append(self.elapsed_steps(start, stop - start, before - 1))
        at = 0
        for start, stop in parts:
            for block in self._raw.blocks(self.names, start, most_rows=min(stop - start, block_rows(self.schema))):
                table = block.slice(0, stop - start)
                for number in range(len(self.names)):
                    values = values_of(table.column(number), self._raw.decimal)
                    samples[at : at + table.num_rows, number] = values
                at += table.num_rows
                start += table.num_rows
                if start >= stop:
                    break
        return Recording(
            samples, names=self.names, units=self.units, timebase=Timebase.of(self.clock, np.concatenate(elapsed))
        )

    def table(self) -> pa.Table:
        """Read all columns and rows into memory; later reads use this table instead of the file."""
        table = pa.concat_tables(list(self._raw.blocks(self._raw.names)))
        self._raw.rows.close()
        self._raw = replace(self._raw, rows=MemoryRows(table))
        return table

    def close(self) -> None:
        """Close the file and remove temporary files."""
        if self._stamps is not None:
            self._stamps.close()
        self._raw.rows.close()

    def __enter__(self) -> OpenSource:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, cause: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the source."""
        self.close()


def open_source(path: str | os.PathLike[str], options: ReadOptions | None = None) -> OpenSource:
    """Open a file of any known format without reading all of it into memory.

    Parameters
    ----------
    path : path-like
        The file; its content decides the format.
    options : ReadOptions, optional
        Time, rate, channels and units that the user gives; by default they are found in the file.

    Raises
    ------
    InputError
        If the file cannot be read, or can be read in more than one way.
    UsageError
        If the options do not fit the file.
    """
    file, options = Path(path), options or ReadOptions()
    refuse_impossible(options)
    return open_table(file, *select_table(file, read_tables(file), options))


def select_table(file: Path, tables: tuple[RawTable, ...], options: ReadOptions) -> tuple[RawTable, ReadOptions]:
    """Return the table of a file that the options select, in the requested units; close the other tables.

    Returns
    -------
    RawTable
        The selected table.
    ReadOptions
        The options, with the new names of channels that were renamed.

    Raises
    ------
    InputError
        If there are several tables, and no option selects one.
    UsageError
        If the options do not fit the file.
    """
    try:
        tables, options = in_chosen_units(tables, options)
        raw = chosen_table(file, tables, options)
    except BaseException:
        close(tables)
        raise
    close([table for table in tables if table is not raw])
    return raw, options


def in_chosen_units(tables: tuple[RawTable, ...], options: ReadOptions) -> tuple[tuple[RawTable, ...], ReadOptions]:
    """Convert tables by the sensors and units of the options; return them, and the options with new channel names."""
    if options.sensors:
        from becalm.files.calibrated.calibrated_source import with_sensors  # imported only if sensors are given

        tables, options = with_sensors(tables, options)
    return convert_units(tables, options)


def open_table(file: Path, raw: RawTable, options: ReadOptions) -> OpenSource:
    """Return an open source of one table of a file.

    Raises
    ------
    InputError
        If the table cannot be read, or can be read in more than one way; it is closed then.
    UsageError
        If the options do not fit the table; it is closed then.
    """
    try:
        return OpenSource(file, raw, options)
    except InputError as cause:
        if str(cause).startswith(str(file)):  # the message already names the file
            raise
        if isinstance(cause, TimeError):
            raise TimeError(f"{file}: {cause} {raw.joined}".rstrip()) from cause
        raise InputError(f"{file}: {cause}") from cause


def close(tables: Iterable[RawTable]) -> None:
    """Close the rows of tables."""
    for table in tables:
        table.rows.close()


# Read a whole file into memory as a recording.


def read_source(path: str | os.PathLike[str], options: ReadOptions | None = None) -> SourceFile:
    """Read a file of any known format into memory; of several time bases, read the one that the options select.

    Parameters
    ----------
    path : path-like
        The file; its content decides the format.
    options : ReadOptions, optional
        Time, rate and channels that the user gives; by default they are found in the file.

    Returns
    -------
    SourceFile
        The recording, the whole table, and how the file was interpreted.

    Raises
    ------
    InputError
        If the file cannot be read, or can be read in more than one way.
    UsageError
        If the options do not fit the file.
    """
    with open_source(path, options) as source:
        table = source.table()
        return SourceFile(source.recording(), table, source.layout)


def read(  # noqa: PLR0913  (options, all passed by name)
    path: str | os.PathLike[str],
    *,
    channels: Sequence[str] | str | None = None,
    rate_hz: float | None = None,
    time: str | None = None,
    units: Mapping[str, str] | None = None,
    as_written: bool = False,
) -> Recording:
    """Read a recording from a file of any known format; `channels` selects one of several time bases.

    Parameters
    ----------
    path : path-like
        The file.
    channels : sequence of str, optional
        Columns to read, with or without their units; all that look like signals by default.
    rate_hz : float, optional
        Count rows at this rate in Hz instead of reading a time column.
    time : str, optional
        Name of the time column; by default it is found if there is only one candidate.
    units : mapping of str to str, optional
        Units to convert channels to, by channel name, as {"ax": "m/s^2"}. For a channel without a unit in the file,
        the given unit is assumed.
    as_written : bool
        Keep time stamps as they are. By default, stamps that a driver seems to have delayed are put onto an even
        grid, and shifts by summer time are undone.

    Raises
    ------
    InputError
        If the file cannot be read, or can be read in more than one way.
    UsageError
        If a requested column is missing, or cannot be converted.
    """
    names = (channels,) if isinstance(channels, str) else None if channels is None else tuple(channels)
    with open_source(path, ReadOptions(time, rate_hz, names, units=units or {}, as_written=as_written)) as source:
        return source.recording()
