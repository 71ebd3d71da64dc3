"""Dates and times of day as text, read without being told the pattern."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Booleans, Integers
from becalm.errors import TimeError

DATE_TIME, DATE, TIME_OF_DAY = "date-time", "date", "time of day"

_SECOND = 1_000_000_000
_DAY = 86_400 * _SECOND
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

_DATE = r"(?P<a>[0-9]{1,4})(?P<mark>[-/.])(?P<b>[0-9]{1,2}|[A-Za-z]{3})[-/.](?P<c>[0-9]{1,4})"
_CLOCK = r"(?P<h>[0-9]{1,2}):(?P<m>[0-9]{2})(?::(?P<s>[0-9]{2})(?:[.,:](?P<f>[0-9]{1,9}))?)?"
_AFTER = r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|GMT|[+-][0-9]{2}:?[0-9]{2}|[+-][0-9]{2})?"
_PATTERN = rf"^\s*(?:{_DATE})?[T ,;]*(?:{_CLOCK}{_AFTER})?\s*$"
_COMPILED = re.compile(_PATTERN)


@dataclass(frozen=True)
class Instants:
    """Times read from text.

    Attributes
    ----------
    kind : str
        "date-time", "date" or "time of day".
    ns : (N,) int64 array
        Nanoseconds since 1970 (UTC where a zone is given), or since the first midnight.
    missing : (N,) bool array
        Where a cell is empty.
    zoned : bool
        Whether the cells give a time zone.
    """

    kind: str
    ns: Integers
    missing: Booleans
    zoned: bool = False


def kind_of_text(column: pa.ChunkedArray) -> str:
    """Tell by the most of its first cells whether a column of text holds times; "" if not."""
    some = [cell for cell in column.slice(0, 200).to_pylist() if cell and cell.strip()][:50]
    kinds = Counter(_kind_of_cell(cell) for cell in some)
    kind, count = kinds.most_common(1)[0] if kinds else ("", 0)
    return kind if 2 * count > len(some) else ""


def _kind_of_cell(cell: str) -> str:
    found = _COMPILED.match(cell)
    if not found:
        return ""
    if found["a"] is None:
        return TIME_OF_DAY if found["h"] is not None else ""
    return DATE_TIME if found["h"] is not None else DATE


def parse(name: str, column: pa.ChunkedArray, kind: str) -> Instants:
    """Read a column of dates, times of day, or both.

    Raises
    ------
    TimeError
        If a cell is no time, or day and month cannot be told apart.
    """
    text = column.combine_chunks().cast(pa.string())
    parts = pc.extract_regex(text, _PATTERN)
    missing = np.asarray(pc.fill_null(pc.equal(pc.utf8_trim_whitespace(text), ""), True))
    broken = ~missing & np.asarray(pc.is_null(parts))
    ns = np.zeros(len(text), np.int64)
    zones = _field(parts, "zone")
    if kind != TIME_OF_DAY:
        days, wrong = _days(name, parts, ~missing & ~broken)
        ns += days * _DAY
        broken |= wrong & ~missing
    if kind != DATE:
        clock, wrong = _time_of_day(parts)
        ns += clock - _zone_ns(zones)
        broken |= wrong & ~missing
    if broken.any():
        row = int(np.flatnonzero(broken)[0])
        raise TimeError(
            f"Row {row + 1} of the time column {name!r} holds {text[row].as_py()!r}, which is not a {kind}"
            " as the rows before it. Mend the cell, name another column with --time, or count rows with --rate HZ."
        )
    if kind == TIME_OF_DAY:
        ns = past_midnight(ns, missing)
    return Instants(kind, ns, missing, bool(pc.any(pc.not_equal(zones, "")).as_py()))


def _field(parts: pa.Array, name: str) -> pa.Array:
    return pc.fill_null(pc.struct_field(parts, name), "")


def _whole(text: pa.Array, empty: int = 0) -> Integers:
    """Read whole numbers; `empty` where there is none."""
    filled = pc.if_else(pc.equal(text, ""), str(empty), text)
    return np.asarray(filled.cast(pa.int64()))


def _days(name: str, parts: pa.Array, present: Booleans) -> tuple[Integers, Booleans]:
    """Days since 1970 and where the date does not exist."""
    first, last = _field(parts, "a"), _field(parts, "c")
    middle, named_month = _month_numbers(_field(parts, "b"))
    a, b, c = _whole(first), _whole(middle), _whole(last)
    if not present.any():
        return np.zeros(len(a), np.int64), ~present
    year_first = np.asarray(pc.utf8_length(first)) == 4
    if year_first[present].all():
        return _civil(a, b, c)
    if year_first[present].any():
        return np.zeros(len(a), np.int64), year_first
    c = np.where(c < 100, c + 2000, c)
    day_first, month_first = _civil(c, b, a), _civil(c, a, b)
    if named_month or not day_first[1][present].any():
        if named_month or month_first[1][present].any() or _points(parts):
            return day_first
        return _same_either_way(name, day_first, month_first, present)
    return day_first if month_first[1][present].any() else month_first


def _points(parts: pa.Array) -> bool:
    """Tell whether the first date is written with points: then the day comes first."""
    return next((mark for mark in _field(parts, "mark").to_pylist() if mark), "") == "."


def _same_either_way(
    name: str, day_first: tuple[Integers, Booleans], month_first: tuple[Integers, Booleans], present: Booleans
) -> tuple[Integers, Booleans]:
    if np.array_equal(np.diff(day_first[0][present]), np.diff(month_first[0][present])):
        return day_first
    raise TimeError(
        f"The dates in {name!r} can be read day first or month first, and the two differ. "
        "Write them as YYYY-MM-DD, name another column with --time, or count rows with --rate HZ."
    )


def _month_numbers(middle: pa.Array) -> tuple[pa.Array, bool]:
    lower = pc.utf8_lower(middle)
    if not pc.any(pc.match_substring_regex(lower, "[a-z]")).as_py():
        return middle, False
    for number, month in enumerate(_MONTHS, start=1):
        lower = pc.if_else(pc.equal(lower, month), str(number), lower)
    known = pc.match_substring_regex(lower, "^[0-9]*$")
    return pc.if_else(known, lower, "0"), True


def _civil(year: Integers, month: Integers, day: Integers) -> tuple[Integers, Booleans]:
    """Days since 1970 of calendar dates, and where there is no such date."""
    wrong = (month < 1) | (month > 12) | (day < 1) | (day > 31) | (year < 1700) | (year > 2200)
    safe_year, safe_month = np.where(wrong, 1970, year), np.where(wrong, 1, month)
    months = (safe_year - 1970).astype("datetime64[Y]").astype("datetime64[M]") + (safe_month - 1)
    dates = months.astype("datetime64[D]") + (np.where(wrong, 1, day) - 1)
    wrong |= dates.astype("datetime64[M]") != months
    return dates.astype(np.int64), wrong


def _time_of_day(parts: pa.Array) -> tuple[Integers, Booleans]:
    """Nanoseconds since midnight, and where there is no such time."""
    hour, minute, second = (_whole(_field(parts, part), -1) for part in "hms")
    second = np.where(second == -1, 0, second)
    wrong = (hour < 0) | (hour > 23) | (minute < 0) | (minute > 59) | (second > 60)
    half = pc.utf8_lower(pc.utf8_slice_codeunits(_field(parts, "half"), 0, 1))
    afternoon, morning = np.asarray(pc.equal(half, "p")), np.asarray(pc.equal(half, "a"))
    wrong |= (afternoon | morning) & ((hour > 12) | (hour < 1))
    hour = np.where(afternoon | morning, hour % 12, hour) + 12 * afternoon
    fraction = _whole(pc.utf8_rpad(_field(parts, "f"), 9, "0"))
    return ((hour * 60 + minute) * 60 + second) * _SECOND + fraction, wrong


def _zone_ns(zones: pa.Array) -> Integers:
    """How far each cell's zone is ahead of UTC, in nanoseconds."""
    coded = zones.dictionary_encode()
    ahead = np.array([_offset_ns(zone) for zone in coded.dictionary.to_pylist()] or [0], np.int64)
    return np.asarray(ahead[np.asarray(coded.indices)])


def _offset_ns(zone: str) -> int:
    if zone[:1] not in ("+", "-"):
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    minutes = int(digits[:2]) * 60 + int(digits[2:])
    return (-minutes if zone[0] == "-" else minutes) * 60 * _SECOND


def past_midnight(ns: Integers, missing: Booleans) -> Integers:
    """Add a day wherever the clock jumps back by more than half a day."""
    known = np.flatnonzero(~missing)
    out = ns.copy()
    jumps = np.diff(ns[known], prepend=ns[known][:1]) < -_DAY // 2
    out[known] += np.cumsum(jumps) * _DAY
    return out
