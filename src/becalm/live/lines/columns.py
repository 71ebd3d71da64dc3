"""Find the time column and the channels among the columns of lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from becalm.core.time.clock import FASTEST_HZ, SLOWEST_HZ
from becalm.errors import UsageError
from becalm.files.text.cells import TIME, kind_of
from becalm.files.timing.time_column import is_time_name
from becalm.files.units.unit_spelling import parse_header
from becalm.live.address import Address
from becalm.live.lines.cells import Cell, StampReader, number_of, place_named, stamp_reader

ARRIVAL = "arrival"
_AUTO = "auto"


@dataclass(frozen=True)
class LineOptions:
    """Options for reading lines.

    Attributes
    ----------
    format : str
        "csv", "json", or "auto" to detect the format from the first lines.
    columns : tuple of str
        Names of all columns, if no line has them; otherwise ().
    time : str
        Column of stamps, or "arrival" for arrival times; "" for the column whose name means time, or arrival times if
        there is none.
    rate_hz : float or None
        Sample rate in hertz, from which stamps are computed; a time column is then ignored.
    channels : tuple of str
        Columns to use as channels; () for all numeric ones.
    """

    format: str = _AUTO
    columns: tuple[str, ...] = ()
    time: str = ""
    rate_hz: float | None = None
    channels: tuple[str, ...] = ()

    NAMES = ("format", "columns", "time", "rate", "channels")

    @classmethod
    def of(cls, address: Address) -> LineOptions:
        """Return the options of an address.

        Raises
        ------
        UsageError
            If the value of an option is not possible.
        """
        rate_hz = None
        if "rate" in address.options:
            rate_hz = address.number("rate", 0.0, least=SLOWEST_HZ, greatest=FASTEST_HZ)
            if "time" in address.options:
                raise UsageError(f"{address.kind}: rate= and time= exclude each other; give only one of them.")
        return cls(
            address.chosen("format", (_AUTO, "csv", "json"), _AUTO),
            address.names("columns"),
            address.options.get("time", ""),
            rate_hz,
            address.names("channels"),
        )


@dataclass(frozen=True)
class Columns:
    """The columns of a row.

    Attributes
    ----------
    all_names : tuple of str
        Names of all columns.
    names, units : tuple of str
        Names and units of the channels, (m,).
    places : tuple of int
        Indices of the channels in a row.
    stamp_place : int or None
        Index of the stamp in a row; None if stamps are computed from the rate or the arrival times.
    stamp_of : StampReader or None
        Parser of the stamps.
    left_out : tuple of int
        Indices of the columns that are no channels only because the first row has no number there.
    """

    all_names: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    places: tuple[int, ...]
    stamp_place: int | None
    stamp_of: StampReader | None
    left_out: tuple[int, ...] = ()

    def reordered(self, names: Sequence[str]) -> Columns:
        """Return the same columns in another order, which is that of `names`."""

        def place(at: int) -> int:
            return names.index(self.all_names[at])

        return replace(
            self,
            all_names=tuple(names),
            places=tuple(map(place, self.places)),
            stamp_place=None if self.stamp_place is None else place(self.stamp_place),
            left_out=tuple(map(place, self.left_out)),
        )


def columns_of(
    names: Sequence[str], units: Sequence[str], first: Sequence[Cell], options: LineOptions
) -> Columns | None:
    """Return the columns from their names and the first row; None if that row has no channel, or no valid stamp.

    Raises
    ------
    UsageError
        If a column in the options is absent, or more than one could be the time.
    """
    stamp, times = _stamp_place(names, first, options)
    stamp_of = None if stamp is None else stamp_reader(names[stamp], units[stamp], first[stamp])
    if options.channels:
        places = [_place_of_option(name, "channels", names) for name in options.channels]
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
        () if options.channels else tuple(at for at in range(len(names)) if at not in (*places, *times, stamp)),
    )


def _stamp_place(names: Sequence[str], first: Sequence[Cell], options: LineOptions) -> tuple[int | None, list[int]]:
    """Return the index of the stamp, and the indices of all columns that look like times."""
    times = [at for at, name in enumerate(names) if is_time_name(name)]
    if not times:
        times = [at for at, cell in enumerate(first) if isinstance(cell, str) and kind_of(cell) == TIME]
    if options.rate_hz is not None or options.time == ARRIVAL:
        return None, times
    if options.time:
        return _place_of_option(options.time, "time", names), times
    if len(times) > 1:
        choices = " or ".join(f"?time={names[at]}" for at in times)
        raise UsageError(f"{len(times)} columns could be the time; choose one with {choices}, or ?time={ARRIVAL}.")
    return (times[0] if times else None), times


def _place_of_option(name: str, option: str, names: Sequence[str]) -> int:
    place = place_named(name, names)
    if place is None:
        columns = ", ".join(map(repr, names[:20]))
        raise UsageError(f"?{option}= names {name!r}, which is not a column; the columns are {columns}.")
    return place
