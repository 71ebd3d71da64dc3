"""Read a time column in seconds: numbers with a unit, counts since 1970, dates, times of day."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import ceil
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Booleans, Floats, Integers
from becalm.errors import SensorError, TimeError
from becalm.files.column_statistics import ColumnStatistics
from becalm.files.read_options import ReadOptions
from becalm.files.rows import RowsWithTime, Spool
from becalm.files.source import RawTable, TimeLayout
from becalm.files.text.cells import meant_as_numbers, without_blank_end
from becalm.files.timing import clock
from becalm.files.timing.clock import on_one_clock, without_wraps
from becalm.files.timing.time_column import (
    COUNT,
    NUMBERS,
    TEMPORAL,
    TIME_OPTION,
    bad_time_error,
    choose_time,
    find_time,
    kind_of_column,
    named_column,
    numbers,
    times_by_name,
    times_with_bad_cells,
)
from becalm.files.units.unit_spelling import TIME_UNITS, time_unit

PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}  # number of each unit in a second
SECONDS = {"min": 60.0, "h": 3600.0, "d": 86_400.0}  # length of each unit in seconds

_DAY_COUNTS = ((2.5e4, 7.5e4), (6.9e5, 7.7e5))  # Excel, MATLAB: years 1968 to 2105, 1889 to 2108
_SAME_TIME_S = 1e-9  # times that differ by less are equal, but for the rounding of their last digits
_TEN_SECONDS = 10.0 / 86_400.0  # in days
EPOCHS = (("s", 9.4e8, 4.2e9), ("ms", 9.4e11, 4.2e12), ("us", 9.4e14, 4.2e15), ("ns", 9.4e17, 4.2e18))
"""Units of counts since 1970, each with the range of plausible counts: those of the years 1999 to 2103."""


class Stamps:
    """The time of every row in seconds, NaN where it is missing.

    Parameters
    ----------
    spool : Spool
        The numbers of the file.
    in_seconds : callable
        Converts an array of these numbers to seconds.
    """

    def __init__(self, spool: Spool, in_seconds: Callable[[Any], Floats] = np.asarray) -> None:
        self._spool, self._in_seconds = spool, in_seconds
        self.count = spool.count
        self.close = spool.close

    def read(self, start: int, stop: int) -> Floats:
        """Return the seconds of the rows from `start` up to `stop`."""
        return self._in_seconds(self._spool.read(start, stop))

    def blocks(self) -> Iterator[Floats]:
        """Yield the seconds of all rows in small blocks."""
        return map(self._in_seconds, self._spool.blocks())


def read_time(raw: RawTable, columns: tuple[str, ...], as_written: bool = False) -> tuple[Stamps, TimeLayout]:
    """Read the time in seconds from a column, or from a date and a time of day.

    Numbers with a unit, and durations, count from their own zero; dates, times of day and counts since 1970 count from
    the first stamp. Wraps of counters are undone. Shifts by summer time are undone too, unless `as_written`.

    Raises
    ------
    TimeError
        If the cells are not times, or their unit is unknown.
    """
    stamps, layout = _read_stamps(raw, columns)
    if as_written or layout.kind != clock.DATE_TIME or not layout.start or layout.start.endswith("Z"):
        return stamps, layout
    corrected, layout = on_one_clock(stamps, layout)
    if corrected is None:
        return stamps, layout
    stamps.close()
    return Stamps(corrected), layout


def _read_stamps(raw: RawTable, columns: tuple[str, ...]) -> tuple[Stamps, TimeLayout]:
    if len(columns) == 2:
        date, time = _reader(raw, columns[0], clock.DATE), _reader(raw, columns[1], clock.TIME_OF_DAY)
        return _from_text(raw, columns, clock.DATE_TIME, _date_and_time(date, time), date)
    name = columns[0]
    kind = kind_of_column(raw.head.column(name))
    if kind == NUMBERS:
        return _numeric(raw, name)
    if kind == TEMPORAL:
        return _temporal(raw, name)
    if not kind:
        if meant_as_numbers(raw, name):
            raise bad_time_error(raw, name)
        raise TimeError(f"The column {name!r} does not hold times; name another with --time, {COUNT}.")
    reader = _reader(raw, name, kind)
    return _from_text(raw, columns, kind, reader.blocks(), reader)


def _reader(raw: RawTable, name: str, kind: str) -> clock.ClockReader:
    return clock.ClockReader(name, kind, lambda: raw.column(name))


def _date_and_time(dates: clock.ClockReader, times: clock.ClockReader) -> Iterator[clock.Instants]:
    for day, of_day in _aligned_blocks(dates.blocks(), times.blocks()):
        ahead: Any = 0 if of_day.ahead_ns is None else of_day.ahead_ns  # the date is that of the time zone
        ns, missing = day.ns + (of_day.ns + ahead) % clock.DAY_NS - ahead, day.missing | of_day.missing
        yield clock.Instants(clock.DATE_TIME, ns, missing, of_day.zoned)


def _aligned_blocks(
    first: Iterator[clock.Instants], second: Iterator[clock.Instants]
) -> Iterator[tuple[clock.Instants, clock.Instants]]:
    """Yield pairs of blocks, one of each column, with equal numbers of rows."""
    one, other = next(first, None), next(second, None)
    while one is not None and other is not None:
        count = min(len(one.ns), len(other.ns))
        yield one.cut(0, count), other.cut(0, count)
        one = one.cut(count, None) if len(one.ns) > count else next(first, None)
        other = other.cut(count, None) if len(other.ns) > count else next(second, None)


def _from_text(
    raw: RawTable, columns: tuple[str, ...], kind: str, blocks: Iterator[clock.Instants], dates: clock.ClockReader
) -> tuple[Stamps, TimeLayout]:
    since, zoned = _SinceFirst(1e9), False

    def seconds() -> Iterator[Floats]:
        nonlocal zoned
        for block in blocks:
            zoned = zoned or block.zoned
            yield since.seconds(block.ns, block.missing)

    stamps = Stamps(Spool(seconds(), raw.count))
    dated = kind != clock.TIME_OF_DAY and since.first is not None and dates.dated
    start = str(np.datetime64(since.first, "ns")) + ("Z" if zoned else "") if dated else ""
    return stamps, TimeLayout(columns, kind, "", start, (dates.note,) if dates.note else ())


class _SinceFirst:
    """A converter of ticks to seconds since the first tick that is not missing."""

    def __init__(self, per_second: float) -> None:
        self._per_second = per_second
        self.first: int | None = None

    def seconds(self, ticks: Integers, missing: Booleans) -> Floats:
        if self.first is None and not missing.all():
            self.first = int(ticks[np.flatnonzero(~missing)[0]])
        seconds: Floats = (ticks - (self.first or 0)) / self._per_second
        seconds[missing] = np.nan
        return seconds


def _temporal(raw: RawTable, name: str) -> tuple[Stamps, TimeLayout]:
    kind = raw.type_of(name)
    unit = "ms" if pa.types.is_date(kind) else kind.unit
    since, midnights = _SinceFirst(PER_SECOND[unit]), clock.Midnights()
    if pa.types.is_time(kind):
        since = _SinceFirst(1e9)
    elif pa.types.is_duration(kind):
        since.first = 0

    def seconds() -> Iterator[Floats]:
        for column in raw.column(name):
            ticks, missing = _ticks(column)
            if pa.types.is_time(kind):
                ticks = midnights.add_days(ticks * (10**9 // int(PER_SECOND[unit])), missing)
            yield since.seconds(ticks, missing)

    stamps = Stamps(Spool(seconds(), raw.count))
    if pa.types.is_duration(kind):
        return stamps, TimeLayout((name,), "duration", unit)
    if pa.types.is_time(kind):
        return stamps, TimeLayout((name,), clock.TIME_OF_DAY)
    zoned = "Z" if getattr(kind, "tz", None) else ""
    return stamps, TimeLayout(
        (name,), clock.DATE_TIME, "", str(np.int64(since.first or 0).astype(f"datetime64[{unit}]")) + zoned
    )


def _ticks(column: pa.ChunkedArray) -> tuple[Integers, Booleans]:
    missing = np.asarray(column.is_null().to_numpy())
    if pa.types.is_date(column.type):
        column = column.cast(pa.timestamp("ms"))
    ticks = column.cast(pa.int32() if pa.types.is_time32(column.type) else pa.int64())
    return np.asarray(pc.fill_null(ticks, 0).to_numpy()).astype(np.int64), missing


def _numeric(raw: RawTable, name: str) -> tuple[Stamps, TimeLayout]:
    unit = time_unit(name, raw.units.get(name, ""))
    if unit not in ("", *TIME_UNITS.values()):
        raise TimeError(
            f"The time column {name!r} has the unit {unit!r}, which is not one of time. Write s, ms, us, ns, min, h or"
            f" d in its name (as in '{name} (ms)'), {COUNT}."
        )
    statistics = ColumnStatistics(raw.count)
    exact = pa.types.is_integer(raw.type_of(name)) and not any(column.null_count for column in raw.column(name))
    notes: tuple[str, ...] = ()
    spool = Spool(_examined_blocks(raw, name, statistics, exact), raw.count)
    if statistics.falls:
        spool, notes = without_wraps(name, spool)
        statistics = _statistics(spool) if notes else statistics
    epoch = _epoch(statistics, unit)
    if epoch:
        start = str(np.datetime64(int(statistics.first_known / PER_SECOND[epoch] * 1e6), "us")) + "Z"
        return Stamps(spool, _epoch_seconds(spool, statistics, epoch, exact)), TimeLayout(
            (name,), "epoch", epoch, start, notes
        )
    if unit in PER_SECOND:
        return Stamps(spool, lambda values: values / PER_SECOND[unit]), TimeLayout(
            (name,), "numbers", unit, notes=notes
        )
    if unit in SECONDS:
        return Stamps(spool, lambda values: values * SECONDS[unit]), TimeLayout((name,), "numbers", unit, notes=notes)
    try:
        _refuse_unknown_unit(name, statistics)
    except TimeError:
        spool.close()
        raise
    return Stamps(spool, lambda values: np.asarray(values, np.float64)), TimeLayout(
        (name,), "numbers", "s", notes=notes
    )


def _statistics(spool: Spool) -> ColumnStatistics:
    statistics = ColumnStatistics(spool.count)
    for block in spool.blocks():
        statistics.add(np.asarray(block, np.float64))
    return statistics


def _examined_blocks(
    raw: RawTable, name: str, statistics: ColumnStatistics, exact: bool
) -> Iterator[Floats | Integers]:
    """Yield the blocks of a column, and add each to the statistics; `exact` columns are int64, others float64."""
    for column in raw.column(name):
        if pa.types.is_float32(column.type):
            column = column.cast(pa.string())  # to the shortest decimal text: 0.01, not 0.009999999776
        values = numbers(column)
        if not np.isfinite(values).all():
            values = np.where(np.isfinite(values), values, np.nan)
        statistics.add(values)
        yield np.asarray(column.to_numpy()).astype(np.int64) if exact else values


def _epoch(statistics: ColumnStatistics, unit: str) -> str:
    """Return the unit of a count since 1970, "" if the numbers are not such a count."""
    steps = statistics.steps
    if not len(steps):
        return ""
    middle, step = float(np.median(statistics.values)), abs(float(np.median(steps)))
    for name, low, high in EPOCHS:
        if low <= middle <= high and unit in ("", name):
            return name if step <= 3600.0 * PER_SECOND[name] else ""
    return ""


def _epoch_seconds(spool: Spool, statistics: ColumnStatistics, unit: str, exact: bool) -> Callable[[Any], Floats]:
    per_second = PER_SECOND[unit]
    if exact:
        first = spool.read(0, 1)[0]
        return lambda ticks: np.asarray((ticks - first) / per_second, np.float64)
    # In float64, an epoch is exact to about a microsecond.
    return lambda values: np.round((values - statistics.first_known) / per_second, 6)


def _refuse_unknown_unit(name: str, statistics: ColumnStatistics) -> None:
    if statistics.counts:
        raise TimeError(f"The time column {name!r} only counts rows, so the rate is unknown; give it with --rate HZ.")
    steps = statistics.steps
    if not len(steps) or statistics.falls or not (np.median(steps) > 0):
        return  # the time base refuses such stamps with a message of its own
    median = float(np.median(steps))
    first = statistics.first
    if _are_clock_digits(statistics.values, steps):
        raise TimeError(
            f"The time column {name!r} has no unit and looks like hours, minutes and seconds (hhmmss.ss: {first:g})."
            f" Write it as hh:mm:ss.ss, or name it '{name} (s)' if it is seconds, {COUNT}."
        )
    dates = any(low <= first <= high for low, high in _DAY_COUNTS) and 0.0 < median < _TEN_SECONDS
    if dates or _are_day_fractions(statistics.values, steps):
        raise TimeError(
            f"The time column {name!r} has no unit and looks like days (an Excel or MATLAB date: {first:.6f})."
            f" Write it as YYYY-MM-DD hh:mm:ss.fff, or name it '{name} (s)' if it is seconds, {COUNT}."
        )
    if not 0.0 < median < 1.0 or statistics.whole:
        raise TimeError(
            f"The time column {name!r} has no unit and steps of {median:.6g}: seconds, milliseconds or ticks?"
            f" Put the unit in its name (as in '{name} (ms)'), {COUNT}."
        )


def _are_clock_digits(values: Floats, steps: Floats) -> bool:
    """Return whether numbers are times of day as hhmmss.ss, which leap by 40 at full minutes."""
    leaps = steps[steps > 30.0] - np.median(steps)
    minutes = np.isclose(leaps, 40.0, atol=0.01) | np.isclose(leaps, 4040.0, atol=0.01)
    digits = bool(np.all((values >= 0.0) & (values % 1e2 < 60.0) & (values % 1e4 < 6e3)))
    return digits and len(leaps) > 0 and bool(minutes.all())


def _are_day_fractions(values: Floats, steps: Floats) -> bool:
    """Return whether numbers are fractions of a day, in steps of whole seconds or in whole numbers of hertz."""
    if not (values[0] > 0.0 and values[-1] < 1.0 and np.all(steps > 0.0)):
        return False
    hertz = 1.0 / (86_400.0 * float(np.mean(steps)))
    whole = hertz if hertz > 1.0 else 1.0 / hertz
    return 0.1 < hertz < 100.0 and abs(whole - round(whole)) < 1e-3


# Determine the time of a table's rows: from the format, from a given rate, or from a time column.


class RowTimes(NamedTuple):
    """The time of the rows of a table.

    Attributes
    ----------
    raw : RawTable
        The table without blank rows at its end.
    layout : TimeLayout
        How the time was read.
    stamps : Stamps or None
        The time of each row, which the caller closes; None if rows are counted.
    rate_hz : float or None
        The rate at which rows are counted; None if there are stamps.
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
        others = tuple(name for name in times_by_name(raw) if name != raw.time.column)
        if raw.time.rate_hz is not None:
            layout = TimeLayout((raw.time.column,), "rate in the file", "s", raw.time.start)
            return RowTimes(raw, layout, None, raw.time.rate_hz, others)
        stamps, layout = read_time(raw, (raw.time.column,), options.as_written)
        return RowTimes(raw, replace(layout, start=raw.time.start), stamps, None, others)
    times = find_time(raw)
    if (count := without_blank_end(raw, times)) < raw.count:
        raw = replace(raw, count=count)
        times = find_time(raw)
    candidates = [column for columns in times for column in columns] + times_with_bad_cells(raw)
    if options.rate_hz is None:
        stamps, layout = read_time(raw, choose_time(raw, times, options.time), options.as_written)
        return RowTimes(raw, layout, stamps, None, tuple(candidates))
    if raw.time is not None and raw.time.rate_hz is not None:  # that column is not of the file
        raw = replace(raw, rows=RowsWithTime(raw.rows, raw.time.column, options.rate_hz))
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
        first, stop = (ceil((at - _SAME_TIME_S) * rate_hz) for at in (start_s, stop_s))
        lasts_s = count / rate_hz
    else:
        first, stop, lasts_s = _rows_before(times.stamps, start_s, stop_s)
    if stop > count or lasts_s < stop_s - _SAME_TIME_S:
        raise SensorError(f"The rows end after {lasts_s:.6g} s. Give an earlier interval.")
    return first, stop


def _rows_before(stamps: Stamps, start_s: float, stop_s: float) -> tuple[int, int, float]:
    """Return the first rows not before `start_s` and `stop_s`, and the duration of all rows in s, with a last step.

    A row without a stamp counts as before a time if the next stamp is before it.
    """
    begin, last_s, first_rows, count = np.nan, 0.0, [stamps.count] * 2, 0
    for block in stamps.blocks():
        finite = block[np.isfinite(block)]
        if len(finite):
            begin = finite[0] if np.isnan(begin) else begin
            last_s = float(finite[-1] - begin)
            for which, at in enumerate((start_s, stop_s)):
                later = np.flatnonzero(block - begin >= at - _SAME_TIME_S)
                first_rows[which] = min(first_rows[which], count + int(later[0])) if len(later) else first_rows[which]
        count += len(block)
    return first_rows[0], first_rows[1], last_s * stamps.count / max(1, stamps.count - 1)
