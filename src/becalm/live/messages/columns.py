"""Find row numbers, stamps and channels among the columns of a message."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.files.timing.time_column import is_time_name
from becalm.files.units.unit_spelling import parse_header
from becalm.live.lines.cells import Cell, StampReader, place_named, stamp_reader
from becalm.live.lines.columns import ARRIVAL, LineOptions

SEQ = "seq"
"""Name of the column of row numbers."""

EXACT_INTEGERS = 2**53
"""Upper limit of row numbers, below which a float64 holds every integer exactly."""

_CACHED = 16  # cached sets of columns; bounded, in case each message has other columns


class UnreadableMessageError(ValueError):
    """A message cannot be read; the text gives the reason, and the reader counts the message."""


@dataclass(frozen=True)
class ParsedMessage:
    """The rows of a message, with the channels in the message's order.

    Attributes
    ----------
    names, units : tuple of str
        Names and units of the channels, (m,).
    seq : int or None
        Number of the first row; None without numbers.
    time_s : (B,) float array or None
        Stamps in seconds; None without stamps.
    values : (B, m) float array
        Readings, NaN where missing.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    seq: int | None
    time_s: Floats | None
    values: Floats


@dataclass(frozen=True)
class Roles:
    """The column of row numbers, the column of stamps, and each channel's column, name and unit."""

    seq: str | None
    stamp: str | None
    channels: tuple[tuple[str, str, str], ...]


class RoleFinder:
    """Finds the roles of columns by their names; the stamps are in the column `time=`, or the one named like a time.

    Parameters
    ----------
    options : LineOptions
        Columns, time, rate and channels from the address.
    """

    def __init__(self, options: LineOptions) -> None:
        self.options = options
        self._roles: dict[tuple[str, ...], Roles] = {}

    def roles(self, columns: tuple[str, ...]) -> Roles:
        """Return the roles of columns; whether the channels are numeric is not checked here.

        Raises
        ------
        UnreadableMessageError
            If a column in the options is absent, or more than one could have the stamps.
        """
        roles = self._roles.get(columns)
        if roles is None:
            if len(self._roles) >= _CACHED:
                self._roles.clear()
            roles = self._roles[columns] = self._find(columns)
        return roles

    def _find(self, columns: tuple[str, ...]) -> Roles:
        times = [column for column in columns if is_time_name(column)]
        stamp = self._stamp(columns, times)
        if self.options.channels:
            used = [_named(name, columns) for name in self.options.channels]
        else:
            used = [column for column in columns if column not in times and column not in (SEQ, stamp)]
        headers = [(column, *parse_header(column)) for column in used]
        names = [name for _, name, _ in headers]
        channels = tuple((column, name if names.count(name) == 1 else column, unit) for column, name, unit in headers)
        return Roles(SEQ if SEQ in columns else None, stamp, channels)

    def _stamp(self, columns: tuple[str, ...], times: list[str]) -> str | None:
        if self.options.rate_hz is not None or self.options.time == ARRIVAL:
            return None
        if self.options.time:
            return _named(self.options.time, columns)
        if len(times) > 1:
            raise UnreadableMessageError(f"in which {' and '.join(times)[:80]} could be the time (write ?time=NAME)")
        return times[0] if times else None


def _named(name: str, columns: tuple[str, ...]) -> str:
    place = place_named(name, columns)
    if place is None:
        raise UnreadableMessageError(f"which has no column {name[:40]!r}")
    return columns[place]


def stamps_reader(column: str, unit: str, first: Cell) -> StampReader:
    """Return the parser of a column of stamps.

    Raises
    ------
    UnreadableMessageError
        If its first cell is not a time.
    """
    try:
        reader = stamp_reader(column, unit, first)
    except UsageError:
        reader = None
    if reader is None:
        raise UnreadableMessageError("which has a row without a stamp")
    return reader


def stamps_of(column: str, cells: Sequence[Cell]) -> Floats:
    """Return the stamps in the cells of a column, in seconds.

    Raises
    ------
    UnreadableMessageError
        If a cell is not a time.
    """
    exact = [float(cell) if type(cell) is int else cell for cell in cells]
    reader = stamps_reader(column, "", exact[0] if exact else None)
    try:
        return np.array([reader.parse(cell) for cell in exact])
    except ValueError as cause:
        raise UnreadableMessageError("which has a row without a stamp") from cause


def first_of(numbers: Floats) -> int:
    """Return the first row number, after checking that the numbers increase by one.

    Raises
    ------
    UnreadableMessageError
        If there are no rows, or their numbers do not increase by one.
    """
    if not len(numbers):
        raise UnreadableMessageError("which has no rows")
    first = float(numbers[0])
    if not (0 <= first < EXACT_INTEGERS and first.is_integer() and (numbers[1:] - numbers[:-1] == 1).all()):
        raise UnreadableMessageError("whose seq does not number its rows one by one")
    return int(first)
