"""What loggers do to time, undone while a file is read, and said: wraps, summer time, jitter, bursts."""

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

_SAID = {
    JITTER: "The stamps of {} jitter by {:.3g} ms about an even {:.6g} Hz; the rows are counted at that rate instead;",
    BURSTS: "The stamps of {} come in bursts, {:.3g} ms (std) about an even {:.6g} Hz that bounds them from below;"
    " the rows are counted at that rate instead;",
}
_KEEP = "keep them as written with --stamps as-written."


class Times(Protocol):
    """The time of every row, in seconds."""

    count: int

    def blocks(self) -> Iterator[Floats]:
        """Give all of it in blocks."""


def without_wraps(name: str, spool: Spool) -> tuple[Spool, tuple[str, ...]]:
    """Undo the wraps of a counter, and say so; a column that falls back otherwise stays as it is."""
    steps = Steps(spool.count)
    for block in spool.blocks():
        steps.add(np.asarray(block, np.float64))
    if (period := steps.wraps_at) is None:
        return spool, ()
    mended = Spool(unwrapped(spool.blocks(), period), spool.count)
    spool.close()
    wraps = f"{steps.falls:,} wraps were" if steps.falls > 1 else "one wrap was"
    return mended, (f"The counter of {name!r} wraps at {period:.0f}; {wraps} undone.",)


def on_one_clock(times: Times, layout: TimeLayout) -> tuple[Spool | None, TimeLayout]:
    """Undo hours that local time was put back or forth; None where there are none.

    Parameters
    ----------
    times : Times
        Seconds since the first instant.
    layout : TimeLayout
        How they were read: its first instant, which has no zone.
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
    mended = Spool((hours.stamps_s for hours in one_clock(times.blocks(), first_s, steps.median)), times.count)
    moved = " and ".join(f"{way} {_times(n)}" for way, n in (("back", back), ("forth", forth)) if n)
    said = f"The clock of {_named(layout)} was put {moved} by an hour, as for summer time; that was undone"
    said += "." if back else "; keep the stamps as written with --stamps as-written."  # time that falls is refused
    return mended, replace(layout, notes=(*layout.notes, said))


def clock_of(times: Times, layout: TimeLayout, as_written: bool = False) -> tuple[Clock, TimeLayout]:
    """Understand stamps; those that a driver made late are put onto the even grid behind them, and that is said.

    Parameters
    ----------
    times : Times
        Stamps in seconds.
    layout : TimeLayout
        How they were read.
    as_written : bool
        Whether they stay as they are.

    Raises
    ------
    TimeError
        If they cannot serve as time.
    """
    try:
        clock = Clock.from_stamps(times.count, times.blocks)
    except TimeError:  # bursts of equal stamps
        if as_written or (counted := _counted(times, layout)) is None:
            raise
        return counted
    if clock.uniform or as_written:
        return clock, layout
    return _counted(times, layout) or (clock, replace(layout, notes=(*layout.notes, *_unsure(times, layout))))


def _unsure(times: Times, layout: TimeLayout) -> list[str]:
    """Say which rate stamps have, if they come in bursts that may be a driver's or the sampling itself."""
    bursts = equal_bursts(times.count, times.blocks)
    return (
        []
        if bursts is None
        else [
            f"The stamps of {_named(layout)} come in bursts of {bursts.rows} rows, and are used as they are;"
            f" if a driver made them of even rows, count those with --rate {bursts.rate_hz:.6g}."
        ]
    )


def _counted(times: Times, layout: TimeLayout) -> tuple[Clock, TimeLayout] | None:
    grid = even_grid(times.count, times.blocks)
    if grid is None:
        return None
    clock = replace(Clock.counted(times.count, 1.0 / grid.step_s, grid.start_s), jitter_s=grid.jitter_s)
    said = f"{_SAID[grid.kind].format(_named(layout), 1e3 * grid.jitter_s, clock.rate_hz)} {_KEEP}"
    return clock, replace(layout, notes=(*layout.notes, said))


def _named(layout: TimeLayout) -> str:
    return " and ".join(map(repr, layout.columns))


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
