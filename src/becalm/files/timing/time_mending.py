"""Correct time stamps as a file is read, and report it: counter wraps, summer time, jitter and bursts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.time.clock import Clock
from becalm.core.time.even_grid import BURSTS, JITTER, equal_bursts, even_grid
from becalm.core.time.repair import Steps, one_clock, unwrapped
from becalm.errors import TimeError
from becalm.files.rows import Spool
from becalm.files.source import TimeLayout

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
    steps = Steps(spool.count)
    for block in spool.blocks():
        steps.add(np.asarray(block, np.float64))
    if (period := steps.wraps_at) is None:
        return spool, ()
    corrected = Spool(unwrapped(spool.blocks(), period), spool.count)
    spool.close()
    wraps = f"{steps.falls:,} wraps were" if steps.falls > 1 else "one wrap was"
    return corrected, (f"The counter of {name!r} wraps at {period:.0f}; {wraps} undone.",)


def on_one_clock(times: Times, layout: TimeLayout) -> tuple[Spool | None, TimeLayout]:
    """Undo shifts of local time by an hour; return None instead of times if there are none.

    Parameters
    ----------
    times : Times
        Seconds since the first instant.
    layout : TimeLayout
        How the times were read; its `start` is the first instant, without a time zone.
    """
    steps = Steps(times.count)
    for block in times.blocks():
        steps.add(block)
    if steps.falls and not steps.falls_an_hour:
        return None, layout
    first_s = float(np.datetime64(layout.start, "ns").astype(np.int64)) / 1e9
    back = forth = 0
    for hours in one_clock(times.blocks(), first_s, steps.median):
        back, forth = hours.back, hours.forth
    if not back + forth:
        return None, layout
    corrected = Spool((hours.stamps_s for hours in one_clock(times.blocks(), first_s, steps.median)), times.count)
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
        Use the stamps as they are.

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
    """Return a note with the rate of stamps in equal bursts, which come from a driver or from the sampling itself."""
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
