"""A file understood and ready to be read in chunks, however long it is."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from types import TracebackType

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.core.time.clock import Clock
from becalm.core.time.timebase import Timebase
from becalm.errors import InputError, TimeError
from becalm.files.calibrated_source import with_sensors
from becalm.files.chunk import Chunk
from becalm.files.other_units import in_units_asked
from becalm.files.read_options import ReadOptions, refuse_impossible
from becalm.files.registry import read_tables
from becalm.files.roles import SIGMA, choose_channels, missing_in, refuse_uncertainties, unit_of, values_of
from becalm.files.rows import HeldRows, block_rows, rebatched
from becalm.files.source import Layout, RawTable, TimeLayout, layout_of
from becalm.files.time_base_choice import chosen_table
from becalm.files.timing.row_times import row_times
from becalm.files.timing.time_mending import clock_of
from becalm.files.timing.times import Stamps
from becalm.sensors.record import Calibration

STRETCHES = 8
"""A sample of a long recording is made of so many parts."""


class OpenSource:
    """A file that was understood; made by `open_source`, to be closed after use.

    Attributes
    ----------
    path : Path
        The file.
    names, units : tuple of str
        The channels to clean.
    clock : Clock
        What its time is like.
    columns : tuple of ColumnLayout
        What each column was taken for; missing cells are not counted yet (`layout` does).
    rows : int
        How many rows there are.
    schema : pyarrow.Schema
        Of the tables of its chunks.
    """

    def __init__(self, path: Path, raw: RawTable, options: ReadOptions) -> None:
        self.path, self._raw = path, raw
        self._stamps: Stamps | None = None
        self._time = TimeLayout((), "counted rows")
        try:
            self._understand(raw, options)
        except BaseException:
            self.close()
            raise

    def _understand(self, raw: RawTable, options: ReadOptions) -> None:
        if raw.count == 0:
            raise InputError("It has columns but no rows; two or more rows are needed.")
        times = row_times(raw, options)
        self._raw, self._stamps, self._time, raw = times.raw, times.stamps, times.layout, times.raw
        chosen = choose_channels(raw, self._time.columns, times.candidates, options.channels, options.asker)
        self.names, self.columns = chosen
        refuse_uncertainties(self.names)
        self.units = tuple(unit_of(raw, name) for name in self.names)
        self.rows: int = raw.count
        self.schema: pa.Schema = raw.rows.schema
        self.clock = Clock.counted(self.rows, times.rate_hz or 1.0)
        if self._stamps is not None:
            self.clock, self._time = clock_of(self._stamps, self._time, options.as_written)
            if self.clock.even:  # then rows can be counted
                self._stamps.close()
                self._stamps = None

    @cached_property
    def layout(self) -> Layout:
        """How the file was understood; reads all of it once, to count the missing cells."""
        counts = missing_in(self._raw)
        columns = tuple(replace(column, missing=count) for column, count in zip(self.columns, counts, strict=True))
        return layout_of(self._raw, self._time, self.clock, columns)

    @property
    def group(self) -> str:
        """What the file calls these channels; "" where all share one time."""
        return self._raw.group

    @property
    def calibrations(self) -> dict[str, Calibration]:
        """What must be known of the channels that sensors turned into their units."""
        return self._raw.calibrations

    @property
    def start(self) -> str:
        """The first instant as ISO 8601 text; "" where the file gives no date."""
        return self._time.start

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person must know of the file, as sentences."""
        return (*self._raw.notes, *self._time.notes)

    @property
    def replaced(self) -> tuple[str, ...]:
        """Columns of the file in whose places uncertainties are written."""
        return tuple(name for name in self.schema.names if name in {own + SIGMA for own in self.names})

    @property
    def rate_hz(self) -> float:
        """Samples per second, 1 over the step."""
        return self.clock.rate_hz

    def chunks(self, rows: int | None = None, first: int = 0) -> Iterator[Chunk]:
        """Read the file from its first row, or another, to the last, as often as asked.

        Parameters
        ----------
        rows : int, optional
            Of each chunk but the last; by default about a million, fewer where there are many columns.
        first : int
            The row to begin with, counted from 0.

        Raises
        ------
        InputError
            If the file turns out to be damaged, or changes meanwhile.
        """
        size = rows or block_rows(self.schema)
        row = first
        for table in rebatched(self._raw.blocks(self._raw.names, first, most_rows=size), size):
            yield Chunk(row, table, self.elapsed_steps(row, table.num_rows), self.names, self._raw.decimal)
            row += table.num_rows
        if self._raw.original is not None:
            self._raw.original.refuse_changed()

    def sha256(self) -> str:
        """Return the hash of the file that was opened, "" where it cannot be read again.

        Raises
        ------
        InputError
            If the file changed since.
        """
        return "" if self._raw.original is None else self._raw.original.sha256()

    def elapsed_steps(self, first: int, count: int, before: int | None = None) -> Floats:
        """Return the steps before each of `count` rows; `before` is the row read before, if not the last."""
        if self._stamps is None:
            return self.clock.elapsed_rows(first, count, before)
        if before is None and first > 0:
            before = first - 1
        last = None if before is None else float(self._stamps.read(before, before + 1)[0])
        return self.clock.elapsed(self._stamps.read(first, first + count), last)

    def seconds(self, first: int, count: int) -> Floats:
        """Return the times of `count` rows in seconds, (count,): as in the file, or since the first row."""
        if self._stamps is None:
            return self.clock.start_s + self.clock.step_s * np.arange(first, first + count, dtype=np.float64)
        return self._stamps.read(first, first + count)

    def recording(self) -> Recording:
        """Read all of it at once."""
        return self.stretches([(0, self.rows)])

    def sample(self, most_rows: int) -> Recording:
        """Read some of it, for tuning: all, or evenly spread stretches with the time between them.

        Parameters
        ----------
        most_rows : int
            How many rows are enough.
        """
        if self.rows <= most_rows:
            return self.recording()
        count = min(STRETCHES, most_rows)
        length = most_rows // count
        starts = np.linspace(0, self.rows - length, count).astype(int).tolist()
        return self.stretches([(start, start + length) for start in starts])

    def stretches(self, parts: list[tuple[int, int]]) -> Recording:
        """Read rows from each start up to each stop, in order; the time between them is kept as a gap."""
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
        """Read all columns of all rows; they are held in memory from then on."""
        table = pa.concat_tables(list(self._raw.blocks(self._raw.names)))
        self._raw.rows.close()
        self._raw = replace(self._raw, rows=HeldRows(table))
        return table

    def close(self) -> None:
        """Remove temporary files."""
        if self._stamps is not None:
            self._stamps.close()
        self._raw.rows.close()

    def __enter__(self) -> OpenSource:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, cause: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()


def open_source(path: str | os.PathLike[str], options: ReadOptions | None = None) -> OpenSource:
    """Understand a file of any known format without holding it in memory.

    Parameters
    ----------
    path : path-like
        The file; its content decides the format.
    options : ReadOptions, optional
        What a person said about time, rate, channels and units; by default all is found out.

    Raises
    ------
    InputError
        If the file cannot be read, or can be read in more than one way.
    UsageError
        If the options do not fit the file.
    """
    file, options = Path(path), options or ReadOptions()
    refuse_impossible(options)
    return understood(file, *as_asked(file, read_tables(file), options))


def as_asked(file: Path, tables: tuple[RawTable, ...], options: ReadOptions) -> tuple[RawTable, ReadOptions]:
    """Return the table of a file that is meant, in the units that are asked for; the others are closed.

    The options come back with the names that channels have now.

    Raises
    ------
    InputError
        If there are several, and nothing was said that chooses one.
    UsageError
        If the options do not fit the file.
    """
    try:
        tables, options = in_units_asked(*with_sensors(tables, options))
        raw = chosen_table(file, tables, options)
    except BaseException:
        close(tables)
        raise
    close([table for table in tables if table is not raw])
    return raw, options


def understood(file: Path, raw: RawTable, options: ReadOptions) -> OpenSource:
    """Understand one table of a file.

    Raises
    ------
    InputError
        If it can be read in more than one way, or not at all; it is closed then.
    """
    try:
        return OpenSource(file, raw, options)
    except InputError as cause:
        if str(cause).startswith(str(file)):  # damage found on the way
            raise
        if isinstance(cause, TimeError):
            raise TimeError(f"{file}: {cause} {raw.joined}".rstrip()) from cause
        raise InputError(f"{file}: {cause}") from cause


def close(tables: Iterable[RawTable]) -> None:
    """Close tables that are not needed."""
    for table in tables:
        table.rows.close()
