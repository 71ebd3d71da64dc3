"""What the columns of lines mean: which is the time, which are channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from becalm.core.time.clock import FASTEST_HZ, SLOWEST_HZ
from becalm.errors import UsageError
from becalm.files.text.cells import TIME, kind_of
from becalm.files.timing.time_column import is_time_name
from becalm.files.unit_spelling import parse_header
from becalm.live.address import Address
from becalm.live.lines.cells import Cell, StampReader, number_of, place_named, stamp_reader

ARRIVAL = "arrival"
_AUTO = "auto"


@dataclass(frozen=True)
class LineOptions:
    """What was said of lines.

    Attributes
    ----------
    format : str
        "csv", "json", or "auto" for what the first lines look like.
    columns : tuple of str
        Names of all columns where no line tells them; () where one does.
    time : str
        The column of stamps, "arrival" for none; "" for what is called time, or when rows come where none is.
    rate_hz : float or None
        At which rows are counted, whatever a column says.
    channels : tuple of str
        The columns to take; () for all of numbers.
    """

    format: str = _AUTO
    columns: tuple[str, ...] = ()
    time: str = ""
    rate_hz: float | None = None
    channels: tuple[str, ...] = ()

    NAMES = ("format", "columns", "time", "rate", "channels")

    @classmethod
    def of(cls, address: Address) -> LineOptions:
        """Take them from an address.

        Raises
        ------
        UsageError
            If one is not possible.
        """
        rate_hz = None
        if "rate" in address.options:
            rate_hz = address.number("rate", 0.0, least=SLOWEST_HZ, greatest=FASTEST_HZ)
            if "time" in address.options:
                raise UsageError(f"{address.kind}: rate counts rows, and time names their stamps; say one of them.")
        return cls(
            address.chosen("format", (_AUTO, "csv", "json"), _AUTO),
            address.names("columns"),
            address.options.get("time", ""),
            rate_hz,
            address.names("channels"),
        )


@dataclass(frozen=True)
class Columns:
    """What the cells of a row mean.

    Attributes
    ----------
    all_names : tuple of str
        Of all columns.
    names, units : tuple of str
        Of the channels, (m,).
    places : tuple of int
        Where they stand in a row.
    stamp_place : int or None
        Where the stamp stands; None where rows are counted, or stamped when they come.
    stamp_of : StampReader or None
        Reads it.
    """

    all_names: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    places: tuple[int, ...]
    stamp_place: int | None
    stamp_of: StampReader | None


def columns_of(
    names: Sequence[str], units: Sequence[str], first: Sequence[Cell], options: LineOptions
) -> Columns | None:
    """Say what columns mean, by their names and the first row; None where that row does not tell.

    Raises
    ------
    UsageError
        If a column that was named is not there, or more than one could be the time.
    """
    stamp, times = _stamp_place(names, first, options)
    stamp_of = None if stamp is None else stamp_reader(names[stamp], units[stamp], first[stamp])
    if options.channels:
        places = [_asked_place(name, "channels", names) for name in options.channels]
    else:
        places = [at for at in range(len(names)) if at not in times and number_of(first[at]) is not None]
    places = [at for at in places if at != stamp]
    if not places or (stamp is not None and stamp_of is None):
        return None
    return Columns(
        tuple(names),
        tuple(names[at] for at in places),
        tuple(units[at] or parse_header(names[at])[1] for at in places),
        tuple(places),
        stamp,
        stamp_of,
    )


def _stamp_place(names: Sequence[str], first: Sequence[Cell], options: LineOptions) -> tuple[int | None, list[int]]:
    """Return where the stamp is, and all that look like times."""
    times = [at for at, name in enumerate(names) if is_time_name(name)]
    if not times:
        times = [at for at, cell in enumerate(first) if isinstance(cell, str) and kind_of(cell) == TIME]
    if options.rate_hz is not None or options.time == ARRIVAL:
        return None, times
    if options.time:
        return _asked_place(options.time, "time", names), times
    if len(times) > 1:
        listed = " or ".join(f"?time={names[at]}" for at in times)
        raise UsageError(f"{len(times)} columns could be the time; choose one with {listed}, or say ?time={ARRIVAL}.")
    return (times[0] if times else None), times


def _asked_place(name: str, option: str, names: Sequence[str]) -> int:
    place = place_named(name, names)
    if place is None:
        listed = ", ".join(map(repr, names[:20]))
        raise UsageError(f"?{option}= names {name!r}, which is no column; there are {listed}.")
    return place
