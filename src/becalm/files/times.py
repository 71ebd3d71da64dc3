"""The seconds in a time column: numbers with a unit, counts since 1970, dates, times of day."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Booleans, Floats, Integers
from becalm.errors import TimeError
from becalm.files import clock
from becalm.files.source import RawTable, TimeLayout
from becalm.files.time_column import COUNT, NUMBERS, TEMPORAL, is_counter, kind_of_column, numbers
from becalm.files.units import parse_header

PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
SECONDS = {"min": 60.0, "h": 3600.0}

_DAY_COUNTS = ((2.5e4, 7.5e4), (6.9e5, 7.7e5))  # Excel, MATLAB: years 1968 to 2105, 1889 to 2108
_TEN_SECONDS = 10.0 / 86_400.0
_IMPLIED = {"millis": "ms", "micros": "us", "sec": "s", "secs": "s", "second": "s", "seconds": "s"}
_EPOCHS = (("s", 9.4e8, 4.2e9), ("ms", 9.4e11, 4.2e12), ("us", 9.4e14, 4.2e15), ("ns", 9.4e17, 4.2e18))


def read_time(raw: RawTable, columns: tuple[str, ...]) -> tuple[Floats, TimeLayout]:
    """Read the time in seconds: as in the file, or since the first row where the file gives dates.

    Raises
    ------
    TimeError
        If the cells are not times, or their unit cannot be known.
    """
    if len(columns) == 2:
        return _date_and_time(raw, columns)
    name = columns[0]
    column = raw.table.column(name)
    kind = kind_of_column(column)
    if kind == NUMBERS:
        return _numeric(raw, name, column)
    if kind == TEMPORAL:
        return _temporal(name, column)
    if not kind:
        raise TimeError(f"The column {name!r} does not hold times; name another with --time, {COUNT}.")
    read = clock.parse(name, column, kind)
    return _since_first(read.ns, read.missing), TimeLayout(columns, read.kind, "", _start(read))


def _date_and_time(raw: RawTable, columns: tuple[str, ...]) -> tuple[Floats, TimeLayout]:
    date = clock.parse(columns[0], raw.table.column(columns[0]), clock.DATE)
    time = clock.parse(columns[1], raw.table.column(columns[1]), clock.TIME_OF_DAY)
    day = 86_400_000_000_000
    read = clock.Instants(clock.DATE_TIME, date.ns + time.ns % day, date.missing | time.missing, time.zoned)
    return _since_first(read.ns, read.missing), TimeLayout(columns, clock.DATE_TIME, "", _start(read))


def _since_first(ns: Integers, missing: Booleans) -> Floats:
    known = np.flatnonzero(~missing)
    seconds: Floats = (ns - (ns[known[0]] if len(known) else 0)) / 1e9
    seconds[missing] = np.nan
    return seconds


def _start(read: clock.Instants) -> str:
    known = np.flatnonzero(~read.missing)
    if read.kind == clock.TIME_OF_DAY or not len(known):
        return ""
    return str(read.ns[known[0]].astype("datetime64[ns]")) + ("Z" if read.zoned else "")


def _temporal(name: str, column: pa.ChunkedArray) -> tuple[Floats, TimeLayout]:
    kind = column.type
    missing = np.asarray(column.is_null().to_numpy())
    if pa.types.is_date(kind):
        column = column.cast(pa.timestamp("ms"))
    unit = column.type.unit
    ticks = column.cast(pa.int32() if pa.types.is_time32(kind) else pa.int64())
    count = np.asarray(pc.fill_null(ticks, 0).to_numpy()).astype(np.int64)
    first = count[np.flatnonzero(~missing)[0]] if not missing.all() else np.int64(0)
    if pa.types.is_duration(kind):
        seconds: Floats = count / PER_SECOND[unit]
        seconds[missing] = np.nan
        return seconds, TimeLayout((name,), "duration", unit)
    if pa.types.is_time(kind):
        scaled = clock.past_midnight(count * (10**9 // int(PER_SECOND[unit])), missing)
        return _since_first(scaled, missing), TimeLayout((name,), clock.TIME_OF_DAY)
    seconds = (count - first) / PER_SECOND[unit]
    seconds[missing] = np.nan
    zoned = "Z" if getattr(kind, "tz", None) else ""
    return seconds, TimeLayout((name,), clock.DATE_TIME, "", str(first.astype(f"datetime64[{unit}]")) + zoned)


def _numeric(raw: RawTable, name: str, column: pa.ChunkedArray) -> tuple[Floats, TimeLayout]:
    bare, unit = parse_header(name)
    unit = raw.units.get(name, "") or unit or _IMPLIED.get(bare.lower(), "")
    if pa.types.is_float32(column.type):
        column = column.cast(pa.string())  # its shortest decimals: 0.01, not 0.009999999776
    values = np.where(np.isfinite(values := numbers(column)), values, np.nan)
    steps = np.diff(values)
    epoch = _epoch(values, steps, unit)
    if epoch:
        return _epoch_seconds(column, values, epoch), TimeLayout((name,), "epoch", epoch, _epoch_start(values, epoch))
    if unit in PER_SECOND:
        return values / PER_SECOND[unit], TimeLayout((name,), "numbers", unit)
    if unit in SECONDS:
        return values * SECONDS[unit], TimeLayout((name,), "numbers", unit)
    _refuse_unknown_unit(name, values, steps)
    return values, TimeLayout((name,), "numbers", "s")


def _epoch(values: Floats, steps: Floats, unit: str) -> str:
    """Return the unit of a count since 1970, "" if the numbers are none."""
    known, moved = values[np.isfinite(values)], steps[np.isfinite(steps)]
    if not len(moved):
        return ""
    middle, step = float(np.median(known)), abs(float(np.median(moved)))
    for name, low, high in _EPOCHS:
        if low <= middle <= high and unit in ("", name):
            return name if step <= 3600.0 * PER_SECOND[name] else ""
    return ""


def _epoch_seconds(column: pa.ChunkedArray, values: Floats, unit: str) -> Floats:
    if pa.types.is_integer(column.type) and not column.null_count:
        ticks = np.asarray(column.to_numpy()).astype(np.int64)
        return np.asarray((ticks - ticks[0]) / PER_SECOND[unit], np.float64)
    first = values[np.flatnonzero(np.isfinite(values))[0]]
    seconds: Floats = np.round((values - first) / PER_SECOND[unit], 6)  # an epoch in float64 holds no more
    return seconds


def _epoch_start(values: Floats, unit: str) -> str:
    first = values[np.flatnonzero(np.isfinite(values))[0]]
    return str(np.datetime64(int(first / PER_SECOND[unit] * 1e6), "us")) + "Z"


def _refuse_unknown_unit(name: str, values: Floats, steps: Floats) -> None:
    known = steps[np.isfinite(steps)]
    if is_counter(values):
        raise TimeError(f"The time column {name!r} only counts rows, so the rate is unknown; give it with --rate HZ.")
    if not len(known) or (known < 0).any() or not (np.median(known) > 0):
        return  # the time base says what is wrong with it
    median = float(np.median(known))
    first = float(values[0])
    if any(low <= first <= high for low, high in _DAY_COUNTS) and 0.0 < median < _TEN_SECONDS:
        raise TimeError(
            f"The time column {name!r} has no unit and looks like days (an Excel or MATLAB date: {first:.6f})."
            f" Write it as YYYY-MM-DD hh:mm:ss.fff, or name it '{name} (s)' if it is seconds, {COUNT}."
        )
    if not 0.0 < median < 1.0 or np.all(known == np.round(known)):
        raise TimeError(
            f"The time column {name!r} has no unit and steps of {median:.6g}: seconds, milliseconds or ticks?"
            f" Put the unit in its name (as in '{name} (ms)'), {COUNT}."
        )
