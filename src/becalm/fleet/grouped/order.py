"""Rank rows by time. Detect rows that must keep their order, because becalm repairs their clock when it reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from becalm.core.time.repair import StepStatistics
from becalm.errors import TimeError, UsageError
from becalm.files.lake.order import instants_of
from becalm.files.source import HEAD_ROWS, RawTable
from becalm.files.text.cells import is_text
from becalm.files.timing import clock
from becalm.files.timing.time_column import (
    NUMBERS,
    TEMPORAL,
    TIME_OPTION,
    find_time,
    is_time_name,
    kind_of_column,
    named_column,
    numbers,
)
from becalm.files.timing.times import PER_SECOND

Ranks = NDArray[Any]
"""Ranks (n,), which increase with time: int64, uint64 or float64; the value of `latest` where the time is missing."""

_TEXTS = [clock.DATE_TIME], [clock.DATE], [clock.DATE, clock.TIME_OF_DAY]  # text columns that give an instant


def time_of(table: RawTable, asked: str | None) -> tuple[str, ...]:
    """Return the names of the time columns, found by name or type; () if there are none.

    Parameters
    ----------
    table : RawTable
        A file of the lake.
    asked : str, optional
        The time column that a recipe names; None to search for one.
    """
    if asked is None:
        candidates = find_time(replace(table, count=min(table.count, HEAD_ROWS)))
        return next((time for time in candidates if _is_surely_time(table, time[0])), ())
    try:
        return (named_column(table, asked, TIME_OPTION),)
    except UsageError:  # sensors with this recipe are refused later, when they are opened
        return ()


def ranks_of(times: pa.Table) -> Ranks | None:
    """Return ranks (n,) that order rows by time; None if the times cannot be read or have no date.

    Parameters
    ----------
    times : pyarrow.Table
        One time column, or a column of dates and one of times of day.
    """
    kinds = [kind_of_column(column) for column in times.columns]
    if kinds == [NUMBERS]:
        return _of_numbers(times.column(0))
    if kinds == [TEMPORAL]:
        return _of_ticks(times.column(0))
    return _of_text(times, kinds) if kinds in _TEXTS else None


def latest(ranks: Ranks) -> Any:
    """Return the rank of rows whose time is missing."""
    return np.inf if ranks.dtype.kind == "f" else np.iinfo(ranks.dtype).max


def has_clock_reset(ranks: Ranks, time: pa.DataType) -> bool:
    """Return whether times decrease because a counter wrapped, or because local time was set back by an hour.

    Such rows must not be sorted by time, because this would interleave the rows before and after the decrease.

    Parameters
    ----------
    ranks : (n,) array
        Ranks of the rows of one sensor, in the order of the file.
    time : pyarrow.DataType
        Type of the first column of time.
    """
    present = ranks[ranks < latest(ranks)]
    if len(present) < 2:
        return False
    steps, per_second = StepStatistics(len(present)), _local_per_second(time)
    steps.add((present - present[0]) / per_second if per_second else present.astype(np.float64))
    return steps.falls_by_hours if per_second else not pa.types.is_temporal(time) and steps.wraps_at is not None


def _is_surely_time(table: RawTable, name: str) -> bool:
    """Return whether a column has the name or the type of a time; other increasing numbers may be readings."""
    return is_time_name(name) or kind_of_column(table.head.column(name)) != NUMBERS


def _local_per_second(time: pa.DataType) -> float | None:
    """Return the ticks per second of ranks if the column has local times; None for other columns."""
    if is_text(time):
        return PER_SECOND["ns"]
    return PER_SECOND[time.unit] if pa.types.is_timestamp(time) and time.tz is None else None


def _of_numbers(column: pa.ChunkedArray) -> Ranks:
    if not pa.types.is_integer(column.type):
        values = numbers(column)
        return np.where(np.isnan(values), np.inf, values)
    kind = pa.uint64() if pa.types.is_uint64(column.type) else pa.int64()
    return _filled(column.cast(kind))


def _of_ticks(column: pa.ChunkedArray) -> Ranks | None:
    if pa.types.is_time(column.type):
        return None
    return _filled(column.cast(pa.timestamp("ms") if pa.types.is_date(column.type) else column.type).cast(pa.int64()))


def _filled(column: pa.ChunkedArray) -> Ranks:
    largest = np.iinfo(column.type.to_pandas_dtype()).max
    return np.asarray(pc.fill_null(column, pa.scalar(largest, column.type)))


def _of_text(times: pa.Table, kinds: Sequence[str]) -> Ranks | None:
    try:
        read = [instants_of(*one) for one in zip(times.column_names, kinds, times.columns, strict=True)]
    except TimeError:  # a cell is not a time, or the order of day and month is not clear
        return None
    missing = np.any([one.missing for one in read], axis=0)
    return np.where(missing, np.iinfo(np.int64).max, np.sum([one.ns for one in read], axis=0))
