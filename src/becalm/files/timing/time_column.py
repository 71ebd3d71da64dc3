"""Find the time column of a table."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.errors import InputError, UsageError
from becalm.files.column_statistics import ColumnStatistics
from becalm.files.read_options import RequestOrigin
from becalm.files.source import RawTable
from becalm.files.text.cells import bad_cell, find_bad_cells, meant_as_numbers
from becalm.files.timing import clock
from becalm.files.units.unit_spelling import TIME_UNITS, parse_header, time_unit

_NAMES = re.compile(
    r"time|times|t|timestamp|timestamps|datetime|date|dateandtime|datetimeutc|clock|elapsed|"
    r"elapsedtime|timeelapsed|relativetime|timerelative|reltime|abstime|absolutetime|systime|"
    r"systemtime|sampletime|runtime|uptime|epoch|unixtime|unix|utc|timeutc|utctime|localtime|"
    r"loggertime|gpstime|sec|secs|second|seconds|millis|micros|zeit|zeitstempel|datum|uhrzeit|"
    r"datumuhrzeit|datumzeit|messzeit|temps|horodatage|heure|dateheure|tempo|ora|dataora|hora|fecha|"
    r"fechahora|tiempo|tijd|tid|tijdstip|czas"
)
_LIKE = re.compile(r"^(?:time|timestamp|elapsed|zeit)(?:since|stamp|from|utc|local|abs|rel|seit|\d)\w*$")
_UNITS = ("", *TIME_UNITS.values())
_NEARLY_EVEN = 0.5  # largest distance of a nearly even step from the median step, as a share of it
COUNT = "or give --rate HZ to count rows at a known rate"
"""The end of every message about a time that cannot be used."""

TIME_OPTION = RequestOrigin("--time")

NUMBERS, TEMPORAL, NO_TIME = "numbers", "temporal", ""
"""Kinds of columns: numbers, one of pyarrow's types of time, and neither; kinds of text are those of `clock`."""


def kind_of_column(column: pa.ChunkedArray) -> str:
    """Return how a column can be read as a time: "numbers", "temporal", a kind of text, or "" if it cannot."""
    kind = column.type
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return NUMBERS
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind) or pa.types.is_time(kind) or pa.types.is_date(kind):
        return TEMPORAL
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return clock.kind_of_text(column)
    return NO_TIME


def is_time_name(header: str) -> bool:
    """Return whether a header is a name for time, in one of several languages."""
    bare = parse_header(header)[0]
    if time_unit(header) not in _UNITS:
        return False
    plain = re.sub(r"[\W_]+", "", bare.rpartition(".")[2].lower())
    return _NAMES.fullmatch(plain) is not None or _LIKE.match(plain) is not None


def numbers(column: pa.ChunkedArray) -> Floats:
    """Return a numeric column as float64, (n,), NaN where a cell is missing; without a copy if possible."""
    if pa.types.is_float16(column.type):
        column = column.cast(pa.float32())
    column = column.cast(pa.float64(), safe=False)
    values = column.chunk(0).to_numpy(zero_copy_only=False) if column.num_chunks == 1 else column.to_numpy()
    return np.asarray(values, np.float64)


def find_time(raw: RawTable) -> list[tuple[str, ...]]:
    """Return the columns that may be the time; each entry is a column, or a date and a time of day together."""
    kinds = {name: kind_of_column(raw.head.column(name)) for name in raw.names}
    named = times_by_name(raw, kinds)
    if not named:
        of_time = [n for n, k in kinds.items() if k in (clock.DATE_TIME, clock.DATE, clock.TIME_OF_DAY, TEMPORAL)]
        named = [name for name in of_time if not _is_empty(raw, name)] or of_time
    dates = [name for name in named if kinds[name] == clock.DATE]
    times = [name for name in named if kinds[name] == clock.TIME_OF_DAY]
    if len(dates) == len(times) == 1:
        rest: list[tuple[str, ...]] = [(name,) for name in named if name not in (*dates, *times)]
        return [(dates[0], times[0]), *rest]
    candidates: list[tuple[str, ...]] = [(name,) for name in named if kinds[name] != clock.DATE] or [
        (name,) for name in named
    ]
    candidates = candidates or ([] if times_with_bad_cells(raw) else _first_column(raw, kinds))
    return candidates + [(name,) for name in _namesakes(raw, candidates, kinds)]


def times_by_name(raw: RawTable, kinds: Mapping[str, str] | None = None) -> list[str]:
    """Return the columns that can be read as a time and have a name for it; `kinds` are those of all columns."""
    kinds = kinds or {name: kind_of_column(raw.head.column(name)) for name in raw.names}
    return [name for name, kind in kinds.items() if kind and is_time_name(name) and not _other_unit(raw, name, kind)]


def _other_unit(raw: RawTable, name: str, kind: str) -> str:
    """Return the unit of a column of numbers if it is not a unit of time, otherwise ""."""
    unit = time_unit(name, raw.units.get(name, ""))
    return unit if kind == NUMBERS and unit not in _UNITS else ""


def _is_empty(raw: RawTable, name: str) -> bool:
    """Return whether the first rows of a column are empty; another column is then preferred as the time."""
    column = raw.head.column(name)
    return bool(column.null_count == len(column))


def _namesakes(raw: RawTable, candidates: list[tuple[str, ...]], kinds: dict[str, str]) -> list[str]:
    """Return columns that repeat the only candidate's name but not its values, such as an `X [s]` for each sensor."""
    if len(candidates) != 1 or kinds[candidates[0][0]] != NUMBERS:
        return []
    first = candidates[0][0]
    alike = [name for name in raw.names if name.startswith(f"{first}_") and name[len(first) + 1 :].isdecimal()]
    return [name for name in alike if kinds[name] == NUMBERS and not _same(raw, first, name)]


def _same(raw: RawTable, one: str, other: str) -> bool:
    pairs = zip(raw.column(one), raw.column(other), strict=True)
    return all(np.array_equal(numbers(first), numbers(second), equal_nan=True) for first, second in pairs)


def times_with_bad_cells(raw: RawTable) -> list[str]:
    """Return the columns of text with a name for time that hold more numbers than bad cells."""
    return [name for name in raw.names if is_time_name(name) and _has_bad_cells(raw, name)]


def _has_bad_cells(raw: RawTable, name: str) -> bool:
    return not kind_of_column(raw.head.column(name)) and meant_as_numbers(raw, name)


def bad_time_error(raw: RawTable, name: str) -> InputError:
    """Return the error that names the first cell of a time column that is not a number."""
    bad = find_bad_cells(raw, name)
    if not bad.cells:
        return InputError(
            f"The time column {name!r} holds whole numbers that 64 bits would round. Write fewer digits, {COUNT}."
        )
    return bad_cell(raw, name, bad, f", name another time column with --time, {COUNT}")


def _first_column(raw: RawTable, kinds: dict[str, str]) -> list[tuple[str, ...]]:
    name = raw.names[0]
    if kinds[name] != NUMBERS or len(raw.names) < 2 or _other_unit(raw, name, NUMBERS):
        return []
    statistics = ColumnStatistics(raw.count)
    for column in raw.column(name):
        statistics.add(numbers(column))
        if not statistics.rises:
            return []
    steps = statistics.steps
    if not len(steps):
        return []
    median = np.median(steps)
    even = np.mean(np.abs(steps - median) <= _NEARLY_EVEN * median)
    return [(name,)] if even >= 0.9 else []


def choose_time(raw: RawTable, found: list[tuple[str, ...]], asked: str | None) -> tuple[str, ...]:
    """Return the time column, or the date and the time of day.

    Parameters
    ----------
    raw : RawTable
        The file.
    found : list of tuple of str
        The candidates from `find_time`.
    asked : str, optional
        The column that the user names.

    Raises
    ------
    UsageError
        If `asked` is not a column.
    InputError
        If there is no time or more than one, or a cell of it is not a number.
    """
    if asked is not None:
        return (named_column(raw, asked, TIME_OPTION),)
    if not found:
        for name in times_with_bad_cells(raw):
            raise bad_time_error(raw, name)
        first = raw.names[0]
        unit = _other_unit(raw, first, kind_of_column(raw.head.column(first)))
        why = f"has the unit {unit!r}, which is not one of time" if unit else "does not rise evenly"
        raise InputError(
            f"There is no time column (no name means time, and the first column {why}). Name it with --time COLUMN, "
            + COUNT
            + "."
        )
    if len(found) > 1:
        listed = " or ".join(f"--time {columns[-1]!r}" for columns in found)
        raise InputError(f"{len(found)} columns could be the time; choose one with {listed}, {COUNT}.")
    return found[0]


def named_column(raw: RawTable, asked: str, origin: RequestOrigin) -> str:
    """Return the name of a column, given with or without its unit.

    Raises
    ------
    UsageError
        If no column has that name, or more than one.
    """
    names = raw.names
    if asked in names:
        return asked
    bare = [name for name in names if parse_header(name)[0] == asked.strip() or name.strip() == asked.strip()]
    if len(bare) == 1:
        return bare[0]
    if bare:
        raise UsageError(f"{origin.name} {asked!r} matches {', '.join(map(repr, bare))}; write one of these in full.")
    listed = ", ".join(map(repr, names[:20])) + (f" and {len(names) - 20} more" if len(names) > 20 else "")
    raise UsageError(f"{origin.name} names {asked!r}, which is not a column; the columns are {listed}.{origin.advice}")
