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
from becalm.files.timing.dates import YEAR_FIRST, Dates, days_of, field_of, whole_numbers

DATE_TIME, DATE, TIME_OF_DAY = "date-time", "date", "time of day"  # kinds of times

_SECOND = 1_000_000_000  # in ns
DAY_NS = 86_400 * _SECOND

_DATE = r"(?P<a>[0-9]{1,4})(?P<mark>[-/.])(?P<b>[0-9]{1,2}|[A-Za-z]{3})[-/.](?P<c>[0-9]{1,4})"
_CLOCK = r"(?P<h>[0-9]{1,2}):(?P<m>[0-9]{2})(?::(?P<s>[0-9]{2})(?:[.,:](?P<f>[0-9]{1,9}))?)?"
_SPACE = "[\\s\u00a0\u202f]*"  # also spaces that do not break, as English Windows writes them before PM
_AFTER = rf"{_SPACE}(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|GMT|[+-][0-9]{{2}}:?[0-9]{{2}}|[+-][0-9]{{2}})?"
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
    ahead_ns : (N,) int64 array or None
        How far each cell's time zone is ahead of UTC, which `ns` already allows for; None for dates.
    """

    kind: str
    ns: Integers
    missing: Booleans
    zoned: bool = False
    ahead_ns: Integers | None = None

    def cut(self, start: int, stop: int | None) -> Instants:
        """Return the rows from `start` up to `stop`."""
        ahead = None if self.ahead_ns is None else self.ahead_ns[start:stop]
        return Instants(self.kind, self.ns[start:stop], self.missing[start:stop], self.zoned, ahead)


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

    Attributes
    ----------
    note : str
        A sentence for the user if dates can be read in several orders.
    dated : bool
        Whether the order of day, month and year is known; if not, the dates are all equal.

    Raises
    ------
    TimeError
        If day and month cannot be distinguished; by `blocks`, if a cell is not a time.
    """

    def __init__(self, name: str, kind: str, column: Callable[[], Iterable[pa.ChunkedArray]]) -> None:
        self._name, self._kind, self._column = name, kind, column
        self.note, self.dated = "", True
        self._order = YEAR_FIRST if kind == TIME_OF_DAY or _all_years_first(column()) else ""
        if not self._order:
            dates = Dates()
            for block in column():
                dates.add(*_parts(block)[1:])
            self._order, self.note, self.dated = dates.order(name)

    def blocks(self) -> Iterator[Instants]:
        """Yield the times of the column block by block."""
        midnights, row = Midnights(), 0
        for block in self._column():
            text, parts, missing = _parts(block)
            bad = ~missing & np.asarray(pc.is_null(parts))
            ns = np.zeros(len(text), np.int64)
            zones, ahead = field_of(parts, "zone"), None
            if not row:
                self._refuse_minutes(parts)
            if self._kind != TIME_OF_DAY:
                days, wrong = days_of(parts, ~missing & ~bad, self._order)
                ns += days * DAY_NS
                bad |= wrong & ~missing
            if self._kind != DATE:
                clock, wrong = _time_of_day(parts)
                ahead = _zone_ns(zones)
                ns += clock - ahead
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
            yield Instants(self._kind, ns, missing, bool(pc.any(pc.not_equal(zones, "")).as_py()), ahead)

    def _refuse_minutes(self, parts: pa.Array) -> None:
        """Refuse elapsed times of two numbers, which may be minutes and seconds."""
        two = self._kind == TIME_OF_DAY and not pc.any(pc.not_equal(field_of(parts, "s"), "")).as_py()
        if two and re.search(r"(?i)elapsed|runtime|uptime|reltime|relative|duration", self._name):
            raise TimeError(
                f"The times in {self._name!r} have two numbers: hours and minutes, or minutes and seconds?"
                " Write them as hh:mm:ss, name another column with --time, or count rows with --rate HZ."
            )


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


def _time_of_day(parts: pa.Array) -> tuple[Integers, Booleans]:
    """Return nanoseconds since midnight, and a mask of times that do not exist."""
    hour, minute, second = (whole_numbers(field_of(parts, part), -1) for part in "hms")
    second = np.where(second == -1, 0, second)
    wrong = (hour < 0) | (hour > 23) | (minute < 0) | (minute > 59) | (second > 60)
    half = pc.utf8_lower(pc.utf8_slice_codeunits(field_of(parts, "half"), 0, 1))
    afternoon, morning = np.asarray(pc.equal(half, "p")), np.asarray(pc.equal(half, "a"))
    wrong |= (afternoon | morning) & ((hour > 12) | (hour < 1))
    hour = np.where(afternoon | morning, hour % 12, hour) + 12 * afternoon
    fraction = whole_numbers(pc.utf8_rpad(field_of(parts, "f"), 9, "0"))
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
_SEVERAL_GAPS = 0.01  # share of rows after a gap above which coarse stamps may hide another rate
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
        return clock, replace(layout, notes=(*layout.notes, *_coarse_notes(clock, layout)))
    return _on_even_grid(times, layout) or (clock, replace(layout, notes=(*layout.notes, *_burst_notes(times, layout))))


def _coarse_notes(clock: Clock, layout: TimeLayout) -> list[str]:
    """Return a note on gaps that may be rounding: many steps of two digits among steps of one."""
    if clock.gaps <= _SEVERAL_GAPS * clock.count or clock.resolution_s <= clock.step_s / 2:
        return []
    return [
        f"The stamps of {_named(layout)} have one digit a step, and {clock.gaps:,} longer steps are read as lost rows;"
        " if the rate is only no whole number of digits and hardly a row is lost, count rows with --rate HZ."
    ]


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
