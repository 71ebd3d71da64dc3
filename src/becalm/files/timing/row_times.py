"""Determine the time of a table's rows: from the format, from a given rate, or from a time column."""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from typing import NamedTuple

import numpy as np

from becalm.errors import SensorError
from becalm.files.read_options import ReadOptions
from becalm.files.source import RawTable, TimeLayout
from becalm.files.text.cells import without_blank_end
from becalm.files.timing.time_column import TIME_OPTION, choose_time, find_time, named_column, times_with_bad_cells
from becalm.files.timing.times import Stamps, read_time


class RowTimes(NamedTuple):
    """The time of the rows of a table.

    Attributes
    ----------
    raw : RawTable
        The table without blank rows at its end.
    layout : TimeLayout
        How the time was read.
    stamps : Stamps or None
        The time of each row, to be closed after use; None if rows are counted.
    rate_hz : float or None
        The rate at which rows are counted.
    candidates : tuple of str
        Columns that look like a time.
    """

    raw: RawTable
    layout: TimeLayout
    stamps: Stamps | None
    rate_hz: float | None
    candidates: tuple[str, ...] = ()


def row_times(raw: RawTable, options: ReadOptions) -> RowTimes:
    """Return the time of the rows of a table.

    Raises
    ------
    UsageError
        If the time that the options name is not a column.
    InputError
        If there is no time or more than one, or it cannot be read.
    """
    if raw.time is not None and options.rate_hz is None and options.time is None:
        if raw.time.rate_hz is not None:
            layout = TimeLayout((raw.time.column,), "rate in the file", "s", raw.time.start)
            return RowTimes(raw, layout, None, raw.time.rate_hz)
        stamps, layout = read_time(raw, (raw.time.column,), options.as_written)
        return RowTimes(raw, replace(layout, start=raw.time.start), stamps, None)
    times = find_time(raw)
    if (count := without_blank_end(raw, times)) < raw.count:
        raw = replace(raw, count=count)
        times = find_time(raw)
    candidates = [column for columns in times for column in columns] + times_with_bad_cells(raw)
    if options.rate_hz is None:
        stamps, layout = read_time(raw, choose_time(raw, times, options.time), options.as_written)
        return RowTimes(raw, layout, stamps, None, tuple(candidates))
    if options.time is not None:
        candidates.append(named_column(raw, options.time, TIME_OPTION))
    return RowTimes(raw, TimeLayout((), "counted rows"), None, options.rate_hz, tuple(candidates))


def rows_between(times: RowTimes, start_s: float, stop_s: float) -> tuple[int, int]:
    """Return the first row at or after `start_s`, and the first at or after `stop_s`, both in seconds after row 0.

    Raises
    ------
    SensorError
        If the rows end before `stop_s`.
    """
    count = times.raw.count
    if times.stamps is None:
        rate_hz = times.rate_hz or 1.0
        first, stop, lasts_s = ceil(start_s * rate_hz), ceil(stop_s * rate_hz), count / rate_hz
    else:
        first, stop, lasts_s = _rows_before(times.stamps, start_s, stop_s)
    if stop > count or lasts_s < stop_s:
        raise SensorError(f"The rows end after {lasts_s:.6g} s. Give an earlier interval.")
    return first, stop


def _rows_before(stamps: Stamps, start_s: float, stop_s: float) -> tuple[int, int, float]:
    """Return the numbers of rows before two times in seconds, and the duration of all rows with one step at the end."""
    begin, last_s, before = np.nan, 0.0, [0, 0]
    for block in stamps.blocks():
        finite = block[np.isfinite(block)]
        if not len(finite):
            continue
        begin = finite[0] if np.isnan(begin) else begin
        last_s = float(finite[-1] - begin)
        before = [rows + int((block - begin < at).sum()) for rows, at in zip(before, (start_s, stop_s), strict=True)]
    return before[0], before[1], last_s * stamps.count / max(1, stamps.count - 1)
