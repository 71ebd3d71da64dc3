"""From a path to a recording."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.core.timebase import FASTEST_HZ, SLOWEST_HZ, Timebase
from becalm.errors import InputError, TimeError, UsageError
from becalm.files.registry import read_raw
from becalm.files.roles import choose_channels, samples_of, unit_of
from becalm.files.source import RawTable, ReadOptions, SourceFile, TimeLayout, layout_of
from becalm.files.time_column import choose_time, find_time, named_column
from becalm.files.times import read_time


def read_source(path: str | os.PathLike[str], options: ReadOptions | None = None) -> SourceFile:
    """Read a CSV, CSV.GZ or Parquet file.

    Parameters
    ----------
    path : path-like
        The file; its content decides the format.
    options : ReadOptions, optional
        What a person said about time, rate and channels; by default all is found out.

    Returns
    -------
    SourceFile
        The recording, the whole table, and how the file was understood.

    Raises
    ------
    InputError
        If the file cannot be read, or can be read in more than one way.
    UsageError
        If the options do not fit the file.
    """
    file, options = Path(path), options or ReadOptions()
    if options.rate_hz is not None and not SLOWEST_HZ <= options.rate_hz <= FASTEST_HZ:
        raise UsageError(f"--rate {options.rate_hz:g} is not a rate; give hertz, {SLOWEST_HZ:g} to {FASTEST_HZ:g}.")
    raw = read_raw(file)
    try:
        return _understand(raw, options)
    except TimeError as cause:
        raise TimeError(f"{file}: {cause}") from cause
    except InputError as cause:
        raise InputError(f"{file}: {cause}") from cause


def read(
    path: str | os.PathLike[str],
    *,
    channels: Sequence[str] | str | None = None,
    rate_hz: float | None = None,
    time: str | None = None,
) -> Recording:
    """Read a recording from a CSV, CSV.GZ or Parquet file.

    Parameters
    ----------
    path : path-like
        The file.
    channels : sequence of str, optional
        Columns to read, with or without their units; all that look like signals by default.
    rate_hz : float, optional
        Count rows at this rate instead of reading a time column.
    time : str, optional
        Name of the time column; found by itself where it is clear.

    Raises
    ------
    InputError
        If the file cannot be read, or can be read in more than one way.
    UsageError
        If a column asked for is not there.
    """
    asked = (channels,) if isinstance(channels, str) else None if channels is None else tuple(channels)
    return read_source(path, ReadOptions(time, rate_hz, asked)).recording


def _understand(raw: RawTable, options: ReadOptions) -> SourceFile:
    if raw.table.num_rows == 0:
        raise InputError("It has a header but no rows; two or more rows are needed.")
    raw = _without_blank_end(raw)
    candidates = [column for columns in find_time(raw) for column in columns]
    if options.rate_hz is not None:
        if options.time is not None:
            candidates.append(named_column(raw, options.time, "--time"))
        time, stamps = TimeLayout((), "counted rows"), None
    else:
        columns = choose_time(raw, options.time)
        stamps, time = read_time(raw, columns)
    channels, roles = choose_channels(raw, time.columns, candidates, options.channels)
    recording = Recording(
        samples_of(raw, channels),
        names=channels,
        units=[unit_of(raw, name) for name in channels],
        timebase=_timebase(stamps, raw.table.num_rows, options.rate_hz),
    )
    return SourceFile(recording, raw.table, layout_of(raw, time, recording, roles))


def _without_blank_end(raw: RawTable) -> RawTable:
    """Leave out rows of nothing but separators at the end of a text file, if it has a time to tell them by."""
    rows = raw.table.num_rows
    if raw.format != "csv" or not _is_blank(raw, rows - 1) or not find_time(raw):
        return raw
    while rows > 1 and _is_blank(raw, rows - 1):
        rows -= 1
    return replace(raw, table=raw.table.slice(0, rows))


def _is_blank(raw: RawTable, row: int) -> bool:
    return all(column[row].as_py() in (None, "") for column in raw.table.columns)


def _timebase(stamps: Floats | None, count: int, rate_hz: float | None) -> Timebase:
    if stamps is not None:
        return Timebase.from_stamps(stamps)
    return Timebase.even(count, rate_hz or 1.0)
