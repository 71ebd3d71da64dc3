"""What puts rows into the order of time; and which it must not: those whose clock becalm mends as it reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from becalm.core.time.repair import Steps
from becalm.errors import TimeError, UsageError
from becalm.files.lake.order import instants_of
from becalm.files.source import HEAD_ROWS, RawTable
from becalm.files.text.bad_cells import is_text
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
"""What grows with time, (n,), int64, uint64 or float64; `latest` where the time is missing."""

_TEXTS = [clock.DATE_TIME], [clock.DATE], [clock.DATE, clock.TIME_OF_DAY]


def time_of(table: RawTable, asked: str | None) -> tuple[str, ...]:
    """Return the columns that tell the time, by their names or types; () where none does.

    Parameters
    ----------
    table : RawTable
        A file of the lake.
    asked : str, optional
        The column that a recipe names.
    """
    if asked is None:
        found = find_time(replace(table, count=min(table.count, HEAD_ROWS)))
        return next((time for time in found if _says_so(table, time[0])), ())
    try:
        return (named_column(table, asked, TIME_OPTION),)
    except UsageError:  # those sensors are refused for it when they are opened
        return ()


def ranks_of(times: pa.Table) -> Ranks | None:
    """Return what orders rows by their times, (n,); None where these do not tell, or only the time of day.

    Parameters
    ----------
    times : pyarrow.Table
        The column of time, or a date and a time of day.
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


def is_mended(ranks: Ranks, time: pa.DataType) -> bool:
    """Tell whether times only fall where a counter wrapped, or where local time was put back by an hour.

    In the order of their stamps, the rows before and after would be shuffled into each other.

    Parameters
    ----------
    ranks : (n,) array
        Of rows of one sensor, as they came.
    time : pyarrow.DataType
        Of the first column of time.
    """
    known = ranks[ranks < latest(ranks)]
    if len(known) < 2:
        return False
    steps, per_second = Steps(len(known)), _local_per_second(time)
    steps.add((known - known[0]) / per_second if per_second else known.astype(np.float64))
    return steps.falls_an_hour if per_second else not pa.types.is_temporal(time) and steps.wraps_at is not None


def _says_so(table: RawTable, name: str) -> bool:
    """Tell whether a column is called time, or holds times; numbers that only rise may be readings."""
    return is_time_name(name) or kind_of_column(table.head.column(name)) != NUMBERS


def _local_per_second(time: pa.DataType) -> float | None:
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
    except TimeError:  # a cell is no time, or whether day or month comes first is not clear
        return None
    missing = np.any([one.missing for one in read], axis=0)
    return np.where(missing, np.iinfo(np.int64).max, np.sum([one.ns for one in read], axis=0))
