"""The time of a table's rows: told by its format, counted at a rate that was said, or in a column that is found."""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from typing import NamedTuple

import numpy as np

from becalm.errors import SensorError
from becalm.files.read_options import ReadOptions
from becalm.files.source import RawTable, TimeLayout
from becalm.files.text.blank_rows import without_blank_end
from becalm.files.timing.time_column import TIME_OPTION, choose_time, find_time, named_column, spoilt_times
from becalm.files.timing.times import Stamps, read_time


class RowTimes(NamedTuple):
    """When the rows of a table were.

    Attributes
    ----------
    raw : RawTable
        Without blank rows at its end.
    layout : TimeLayout
        Where the time is.
    stamps : Stamps or None
        To be closed after use; None where rows are counted.
    rate_hz : float or None
        At which they are counted.
    candidates : tuple of str
        Columns that could have been the time.
    """

    raw: RawTable
    layout: TimeLayout
    stamps: Stamps | None
    rate_hz: float | None
    candidates: tuple[str, ...] = ()


def row_times(raw: RawTable, options: ReadOptions) -> RowTimes:
    """Find the time of the rows.

    Raises
    ------
    UsageError
        If the time that was said is no column.
    InputError
        If there is no time, or more than one, or it cannot be read.
    """
    if raw.time is not None and options.rate_hz is None and options.time is None:
        if raw.time.rate_hz is not None:
            told = TimeLayout((raw.time.column,), "rate in the file", "s", raw.time.start)
            return RowTimes(raw, told, None, raw.time.rate_hz)
        stamps, told = read_time(raw, (raw.time.column,), options.as_written)
        return RowTimes(raw, replace(told, start=raw.time.start), stamps, None)
    found = find_time(raw)
    if (count := without_blank_end(raw, found)) < raw.count:
        raw = replace(raw, count=count)
        found = find_time(raw)
    candidates = [column for columns in found for column in columns] + spoilt_times(raw)
    if options.rate_hz is None:
        stamps, told = read_time(raw, choose_time(raw, found, options.time), options.as_written)
        return RowTimes(raw, told, stamps, None, tuple(candidates))
    if options.time is not None:
        candidates.append(named_column(raw, options.time, TIME_OPTION))
    return RowTimes(raw, TimeLayout((), "counted rows"), None, options.rate_hz, tuple(candidates))


def rows_between(times: RowTimes, start_s: float, stop_s: float) -> tuple[int, int]:
    """Return the first row from `start_s` on, and the first from `stop_s` on, in seconds after the first row.

    Raises
    ------
    SensorError
        If the rows end before.
    """
    count = times.raw.count
    if times.stamps is None:
        rate_hz = times.rate_hz or 1.0
        first, stop, lasts_s = ceil(start_s * rate_hz), ceil(stop_s * rate_hz), count / rate_hz
    else:
        first, stop, lasts_s = _stamped(times.stamps, start_s, stop_s)
    if stop > count or lasts_s < stop_s:
        raise SensorError(f"The rows end after {lasts_s:.6g} s. Give an earlier stretch.")
    return first, stop


def _stamped(stamps: Stamps, start_s: float, stop_s: float) -> tuple[int, int, float]:
    """Count the rows before two instants; return them, and how long all rows last, with one step after the last."""
    begin, last_s, before = np.nan, 0.0, [0, 0]
    for block in stamps.blocks():
        seen = block[np.isfinite(block)]
        if not len(seen):
            continue
        begin = seen[0] if np.isnan(begin) else begin
        last_s = float(seen[-1] - begin)
        before = [known + int((block - begin < at).sum()) for known, at in zip(before, (start_s, stop_s), strict=True)]
    return before[0], before[1], last_s * stamps.count / max(1, stamps.count - 1)
