"""Read dates and times of day from text whose format is not known in advance."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Booleans, Floats, Integers
from becalm.core.time.clock import Clock
from becalm.core.time.even_grid import BURSTS, JITTER, equal_bursts, even_grid
from becalm.core.time.repair import StepStatistics, undo_clock_changes, unwrap
from becalm.errors import TimeError
from becalm.files.rows import Spool
from becalm.files.source import TimeLayout

DATE_TIME, DATE, TIME_OF_DAY = "date-time", "date", "time of day"  # kinds of times
YEAR_FIRST, DAY_FIRST, MONTH_FIRST, MIXED = "year first", "day first", "month first", "mixed"  # orders of dates

_SECOND = 1_000_000_000  # in ns
DAY_NS = 86_400 * _SECOND
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
        Nanoseconds since 1970 (UTC if a zone is given), or, for times of day, since the first midnight.
    missing : (N,) bool array
        True where a cell is empty.
    zoned : bool
        Whether cells give a time zone.
    """

    kind: str
    ns: Integers
    missing: Booleans
    zoned: bool = False

    def cut(self, start: int, stop: int | None) -> Instants:
        """Return the rows from `start` up to `stop`."""
        return Instants(self.kind, self.ns[start:stop], self.missing[start:stop], self.zoned)


def kind_of_text(column: pa.ChunkedArray) -> str:
    """Return the kind of time that most of the first cells of a column of text hold; "" if they are not times."""
    some = [cell for cell in column.slice(0, 200).to_pylist() if cell and cell.strip()][:50]
    kinds = Counter(_kind_of_cell(cell) for cell in some)
    kind, count = kinds.most_common(1)[0] if kinds else ("", 0)
    return kind if 2 * count > len(some) else ""


def _kind_of_cell(cell: str) -> str:
    match = _COMPILED.match(cell)
    if not match:
        return ""
    if match["a"] is None:
        return TIME_OF_DAY if match["h"] is not None else ""
    return DATE_TIME if match["h"] is not None else DATE


class ClockReader:
    """A reader of a column of dates, times of day, or both, block by block.

    Parameters
    ----------
    name : str
        The name of the column, for messages.
    kind : str
        The kind of its first cells, from `kind_of_text`.
    column : callable
        Returns the column in blocks; it is called for every pass over the column.

    Raises
    ------
    TimeError
        If day and month cannot be distinguished; by `blocks`, if a cell is not a time.
    """

    def __init__(self, name: str, kind: str, column: Callable[[], Iterable[pa.ChunkedArray]]) -> None:
        self._name, self._kind, self._column = name, kind, column
        self._order = YEAR_FIRST if kind == TIME_OF_DAY or _all_years_first(column()) else ""
        if not self._order:
            dates = _Dates()
            for block in column():
                dates.add(*_parts(block)[1:])
            self._order = dates.order(name)

    def blocks(self) -> Iterator[Instants]:
        """Yield the times of the column block by block."""
        midnights, row = Midnights(), 0
        for block in self._column():
            text, parts, missing = _parts(block)
            bad = ~missing & np.asarray(pc.is_null(parts))
            ns = np.zeros(len(text), np.int64)
            zones = _field(parts, "zone")
            if self._kind != TIME_OF_DAY:
                days, wrong = _days(parts, ~missing & ~bad, self._order)
                ns += days * DAY_NS
                bad |= wrong & ~missing
            if self._kind != DATE:
                clock, wrong = _time_of_day(parts)
                ns += clock - _zone_ns(zones)
                bad |= wrong & ~missing
            if bad.any():
                at = int(np.flatnonzero(bad)[0])
                raise TimeError(
                    f"Row {row + at + 1} of the time column {self._name!r} holds {text[at].as_py()!r}, which is not a"
                    f" {self._kind} like the rows before it. Correct the cell, name another column with --time, or"
                    " count rows with --rate HZ."
                )
            if self._kind == TIME_OF_DAY:
                ns = midnights.add_days(ns, missing)
            row += len(text)
            yield Instants(self._kind, ns, missing, bool(pc.any(pc.not_equal(zones, "")).as_py()))


def _parts(block: pa.ChunkedArray) -> tuple[pa.Array, pa.Array, Booleans]:
    """Return the cells as text, their parts by the names in `_PATTERN`, and a mask of empty cells."""
    text = block.combine_chunks().cast(pa.string())
    missing = np.asarray(pc.fill_null(pc.equal(pc.utf8_trim_whitespace(text), ""), True))
    return text, pc.extract_regex(text, _PATTERN), missing


def _all_years_first(column: Iterable[pa.ChunkedArray]) -> bool:
    """Return whether all dates begin with a year of four digits."""
    for block in column:
        first = pc.or_(pc.match_substring_regex(block, r"^\s*[0-9]{4}[-/.]"), pc.match_substring_regex(block, r"^\s*$"))
        if not pc.all(first, min_count=0).as_py():
            return False
    return True


def _field(parts: pa.Array, name: str) -> pa.Array:
    return pc.fill_null(pc.struct_field(parts, name), "")


def _whole(text: pa.Array, empty: int = 0) -> Integers:
    """Convert text to whole numbers; an empty text becomes `empty`."""
    filled = pc.if_else(pc.equal(text, ""), str(empty), text)
    return np.asarray(filled.cast(pa.int64()))


class _Dates:
    """The evidence in all dates of a column on the order of day, month and year."""

    def __init__(self) -> None:
        self._named = False  # whether months are written as names
        self._day_wrong = self._month_wrong = False  # whether a date does not exist if read day or month first
        self._first_years = self._last_years = False  # whether years come first, or last
        self._halves = False  # whether AM or PM is written
        self._same = True  # whether both orders give the same steps between rows
        self._mark = ""
        self._last: int | None = None

    def add(self, parts: pa.Array, missing: Booleans) -> None:
        """Examine the next dates."""
        present = ~missing & ~np.asarray(pc.is_null(parts))
        year_first = np.asarray(pc.utf8_length(_field(parts, "a"))) == 4
        self._mark = self._mark or next((mark for mark in _field(parts, "mark").to_pylist() if mark), "")
        self._halves = self._halves or bool(pc.any(pc.not_equal(_field(parts, "half"), "")).as_py())
        self._named = self._named or _month_numbers(_field(parts, "b"))[1]
        self._first_years = self._first_years or bool(year_first[present].any())
        self._last_years = self._last_years or not year_first[present].all()
        if not present.any() or self._first_years:
            return
        (days, day_wrong), (months, month_wrong) = (_days(parts, present, order) for order in (DAY_FIRST, MONTH_FIRST))
        self._day_wrong = self._day_wrong or bool(day_wrong[present].any())
        self._month_wrong = self._month_wrong or bool(month_wrong[present].any())
        apart = days[present] - months[present]
        last = int(apart[0]) if self._last is None else self._last
        self._same = self._same and bool(np.all(apart == last))
        self._last = last

    def order(self, name: str) -> str:
        """Return the order of day, month and year.

        Raises
        ------
        TimeError
            If both orders of day and month are possible and give different steps between rows.
        """
        if self._first_years:
            return MIXED if self._last_years else YEAR_FIRST
        if self._named or not self._day_wrong:
            if self._named or self._month_wrong or self._mark == "." or self._same:
                return DAY_FIRST
            if self._halves:  # countries that write AM and PM put the month first
                return MONTH_FIRST
            raise TimeError(
                f"The dates in {name!r} can be read day first or month first, and the two differ. "
                "Write them as YYYY-MM-DD, name another column with --time, or count rows with --rate HZ."
            )
        return DAY_FIRST if self._month_wrong else MONTH_FIRST


def _days(parts: pa.Array, present: Booleans, order: str) -> tuple[Integers, Booleans]:
    """Return days since 1970, and a mask of dates that do not exist; a mixed order marks those with the year first."""
    first, last = _field(parts, "a"), _field(parts, "c")
    if not present.any():
        return np.zeros(len(first), np.int64), ~present
    if order == MIXED:
        return np.zeros(len(first), np.int64), np.asarray(pc.utf8_length(first)) == 4
    a, b, c = _whole(first), _whole(_month_numbers(_field(parts, "b"))[0]), _whole(last)
    if order == YEAR_FIRST:
        return _civil(a, b, c)
    c = np.where(c < 100, c + 2000, c)
    return _civil(c, b, a) if order == DAY_FIRST else _civil(c, a, b)


def _month_numbers(middle: pa.Array) -> tuple[pa.Array, bool]:
    """Return months as digits, 0 for an unknown name, and whether there are names."""
    lower = pc.utf8_lower(middle)
    if not pc.any(pc.match_substring_regex(lower, "[a-z]")).as_py():
        return middle, False
    for number, month in enumerate(_MONTHS, start=1):
        lower = pc.if_else(pc.equal(lower, month), str(number), lower)
    is_number = pc.match_substring_regex(lower, "^[0-9]*$")
    return pc.if_else(is_number, lower, "0"), True


def _civil(year: Integers, month: Integers, day: Integers) -> tuple[Integers, Booleans]:
    """Return days since 1970 of calendar dates, and a mask of dates that do not exist."""
    wrong = (month < 1) | (month > 12) | (day < 1) | (day > 31) | (year < 1700) | (year > 2200)
    safe_year, safe_month = np.where(wrong, 1970, year), np.where(wrong, 1, month)
    months = (safe_year - 1970).astype("datetime64[Y]").astype("datetime64[M]") + (safe_month - 1)
    dates = months.astype("datetime64[D]") + (np.where(wrong, 1, day) - 1)
    wrong |= dates.astype("datetime64[M]") != months
    return dates.astype(np.int64), wrong


def _time_of_day(parts: pa.Array) -> tuple[Integers, Booleans]:
    """Return nanoseconds since midnight, and a mask of times that do not exist."""
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
    """Return the offset of each cell's time zone from UTC in nanoseconds, positive east of Greenwich."""
    coded = zones.dictionary_encode()
    ahead = np.array([_offset_ns(zone) for zone in coded.dictionary.to_pylist()] or [0], np.int64)
    return np.asarray(ahead[np.asarray(coded.indices)])


def _offset_ns(zone: str) -> int:
    if zone[:1] not in ("+", "-"):
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    minutes = int(digits[:2]) * 60 + int(digits[2:])
    return (-minutes if zone[0] == "-" else minutes) * 60 * _SECOND


class Midnights:
    """A counter of days, which grows where times of day jump back by more than half a day."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._days = 0

    def add_days(self, ns: Integers, missing: Booleans) -> Integers:
        """Return the next times of day, in nanoseconds since the first midnight."""
        present = np.flatnonzero(~missing)
        if not len(present):
            return ns
        out = ns.copy()
        before = ns[present[0]] if self._last is None else self._last
        days = self._days + np.cumsum(np.diff(ns[present], prepend=before) < -DAY_NS // 2)
        out[present] += days * DAY_NS
        self._last, self._days = int(ns[present[-1]]), int(days[-1])
        return out


# Correct time stamps as a file is read, and report it: counter wraps, summer time, jitter and bursts.

_NOTES = {
    JITTER: "The stamps of {} jitter by {:.3g} ms about an even {:.6g} Hz; the rows are counted at that rate instead;",
    BURSTS: "The stamps of {} come in bursts, {:.3g} ms (std) about an even {:.6g} Hz, and none is before its sample;"
    " the rows are counted at that rate instead;",
}
_KEEP = "keep them as written with --stamps as-written."


class Times(Protocol):
    """The time of every row, in seconds."""

    count: int

    def blocks(self) -> Iterator[Floats]:
        """Yield the times of all rows in blocks."""


def without_wraps(name: str, spool: Spool) -> tuple[Spool, tuple[str, ...]]:
    """Undo the wraps of a counter; return the times and a note, or unchanged times if the column does not wrap.

    The given spool is closed if it is replaced.
    """
    steps = StepStatistics(spool.count)
    for block in spool.blocks():
        steps.add(np.asarray(block, np.float64))
    if (period := steps.wraps_at) is None:
        return spool, ()
    corrected = Spool(unwrap(spool.blocks(), period), spool.count)
    spool.close()
    wraps = f"{steps.falls:,} wraps were" if steps.falls > 1 else "one wrap was"
    return corrected, (f"The counter of {name!r} wraps at {period:.0f}; {wraps} undone.",)


def on_one_clock(times: Times, layout: TimeLayout) -> tuple[Spool | None, TimeLayout]:
    """Undo shifts of local time by an hour; return None instead of times if there is no shift.

    Parameters
    ----------
    times : Times
        Seconds since the first instant.
    layout : TimeLayout
        How the times were read; its `start` is the first instant, without a time zone.
    """
    steps = StepStatistics(times.count)
    for block in times.blocks():
        steps.add(block)
    if steps.falls and not steps.falls_by_hours:
        return None, layout
    first_s = float(np.datetime64(layout.start, "ns").astype(np.int64)) / 1e9
    back = forth = 0
    for hours in undo_clock_changes(times.blocks(), first_s, steps.median):
        back, forth = hours.back, hours.forth
    if not back + forth:
        return None, layout
    corrected = Spool(
        (hours.stamps_s for hours in undo_clock_changes(times.blocks(), first_s, steps.median)), times.count
    )
    moved = " and ".join(f"{way} {_times(n)}" for way, n in (("back", back), ("forth", forth)) if n)
    note = f"The clock of {_named(layout)} was put {moved} by an hour, as for summer time; that was undone"
    # Stamps that go back in time are refused, so keeping them as written is suggested only for shifts forward.
    note += "." if back else "; keep the stamps as written with --stamps as-written."
    return corrected, replace(layout, notes=(*layout.notes, note))


def clock_of(times: Times, layout: TimeLayout, as_written: bool = False) -> tuple[Clock, TimeLayout]:
    """Return the clock of stamps; stamps that a driver delayed are replaced by the even grid of the samples.

    Parameters
    ----------
    times : Times
        Stamps in seconds.
    layout : TimeLayout
        How they were read.
    as_written : bool
        Whether to use the stamps as they are.

    Returns
    -------
    Clock
        The clock.
    TimeLayout
        The layout, with a note if stamps were replaced, or if they come in bursts.

    Raises
    ------
    TimeError
        If the stamps cannot be used as a time.
    """
    try:
        clock = Clock.from_stamps(times.count, times.blocks)
    except TimeError:  # for example bursts of equal stamps
        if as_written or (on_grid := _on_even_grid(times, layout)) is None:
            raise
        return on_grid
    if clock.uniform or as_written:
        return clock, layout
    return _on_even_grid(times, layout) or (clock, replace(layout, notes=(*layout.notes, *_burst_notes(times, layout))))


def _burst_notes(times: Times, layout: TimeLayout) -> list[str]:
    """Return a note on stamps in equal bursts, [] for other stamps; a driver or the sampling may cause bursts."""
    bursts = equal_bursts(times.count, times.blocks)
    return (
        []
        if bursts is None
        else [
            f"The stamps of {_named(layout)} come in bursts of {bursts.rows} rows, and are used as they are;"
            f" if the sensor samples evenly and a driver made the bursts, count rows with --rate {bursts.rate_hz:.6g}."
        ]
    )


def _on_even_grid(times: Times, layout: TimeLayout) -> tuple[Clock, TimeLayout] | None:
    """Return an even clock and a layout with a note, None if the stamps do not lie on an even grid."""
    grid = even_grid(times.count, times.blocks)
    if grid is None:
        return None
    clock = replace(Clock.counted(times.count, 1.0 / grid.step_s, grid.start_s), jitter_s=grid.jitter_s)
    note = f"{_NOTES[grid.kind].format(_named(layout), 1e3 * grid.jitter_s, clock.rate_hz)} {_KEEP}"
    return clock, replace(layout, notes=(*layout.notes, note))


def _named(layout: TimeLayout) -> str:
    return " and ".join(map(repr, layout.columns))


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
