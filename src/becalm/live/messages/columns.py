"""What the columns of a message mean: its rows' numbers and stamps, and its channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.files.timing.time_column import is_time_name
from becalm.files.unit_spelling import parse_header
from becalm.live.lines.cells import Cell, StampReader, place_named, stamp_reader
from becalm.live.lines.columns import ARRIVAL, LineOptions

SEQ = "seq"
"""The column of the rows' numbers."""

EXACT_INTEGERS = 2**53
"""Sequence numbers stay below: every language's float holds them."""

_KNOWN = 16  # sets of columns; a stream has one, and memory stays bounded where each message has another


class UnreadableMessageError(ValueError):
    """Why a message cannot be read; the reader counts it."""


@dataclass(frozen=True)
class ParsedMessage:
    """What a message told, its channels in its own order."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    seq: int | None
    time_s: Floats | None
    values: Floats


@dataclass(frozen=True)
class Roles:
    """What columns are: which has the rows' numbers, which the stamps, and each channel's column, name and unit."""

    seq: str | None
    stamp: str | None
    channels: tuple[tuple[str, str, str], ...]


class RoleFinder:
    """Tells columns by their names, as lines do: `time=`, or the one that is called like a time, has the stamps.

    Parameters
    ----------
    options : LineOptions
        What was said of them.
    """

    def __init__(self, options: LineOptions) -> None:
        self.options = options
        self._known: dict[tuple[str, ...], Roles] = {}

    def roles(self, columns: tuple[str, ...]) -> Roles:
        """Return what columns are, which may be found not to be numbers yet.

        Raises
        ------
        UnreadableError
            If one that was named is not there, or more than one could have the stamps.
        """
        known = self._known.get(columns)
        if known is None:
            if len(self._known) >= _KNOWN:
                self._known.clear()
            known = self._known[columns] = self._found(columns)
        return known

    def _found(self, columns: tuple[str, ...]) -> Roles:
        times = [column for column in columns if is_time_name(column)]
        stamp = self._stamp(columns, times)
        if self.options.channels:
            there = [_named(name, columns) for name in self.options.channels]
        else:
            there = [column for column in columns if column not in times and column not in (SEQ, stamp)]
        heads = [(column, *parse_header(column)) for column in there]
        names = [name for _, name, _ in heads]
        channels = tuple((column, name if names.count(name) == 1 else column, unit) for column, name, unit in heads)
        return Roles(SEQ if SEQ in columns else None, stamp, channels)

    def _stamp(self, columns: tuple[str, ...], times: list[str]) -> str | None:
        if self.options.rate_hz is not None or self.options.time == ARRIVAL:
            return None
        if self.options.time:
            return _named(self.options.time, columns)
        if len(times) > 1:
            raise UnreadableMessageError(f"in which {' and '.join(times)[:80]} could be the time (say ?time=NAME)")
        return times[0] if times else None


def _named(name: str, columns: tuple[str, ...]) -> str:
    place = place_named(name, columns)
    if place is None:
        raise UnreadableMessageError(f"which has no column {name[:40]!r}")
    return columns[place]


def stamps_reader(column: str, unit: str, first: Cell) -> StampReader:
    """Return what reads a column of stamps.

    Raises
    ------
    UnreadableMessageError
        If its first cell is no time.
    """
    try:
        reader = stamp_reader(column, unit, first)
    except UsageError:
        reader = None
    if reader is None:
        raise UnreadableMessageError("which has a row without a stamp")
    return reader


def stamps_of(column: str, cells: Sequence[Cell]) -> Floats:
    """Return the seconds in cells of a column of stamps.

    Raises
    ------
    UnreadableMessageError
        If one of them is no time.
    """
    exact = [float(cell) if type(cell) is int else cell for cell in cells]
    reader = stamps_reader(column, "", exact[0] if exact else None)
    try:
        return np.array([reader.one(cell) for cell in exact])
    except ValueError as cause:
        raise UnreadableMessageError("which has a row without a stamp") from cause


def first_of(numbers: Floats) -> int:
    """Return the first of the rows' numbers, once each is one more than the one before.

    Raises
    ------
    UnreadableMessageError
        If it is not.
    """
    if not len(numbers):
        raise UnreadableMessageError("which has no rows")
    first = float(numbers[0])
    if not (0 <= first < EXACT_INTEGERS and first.is_integer() and (numbers[1:] - numbers[:-1] == 1).all()):
        raise UnreadableMessageError("whose seq does not number its rows one by one")
    return int(first)
