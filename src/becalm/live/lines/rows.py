"""Parse lines of CSV or JSON into rows of numbers, once the columns are known."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import InputError
from becalm.files.text.cells import NUMBER, decimal_of, kind_of, split
from becalm.files.text.csv_header import unique_names
from becalm.files.timing.time_column import is_time_name
from becalm.files.units.unit_spelling import parse_header
from becalm.live.lines.cells import Cell, NumberStamps, number_of, numbers_of
from becalm.live.lines.columns import Columns

_NOT_PLAIN = (b'"', b"#", b"(")  # quotes, comments, nan(1): parse such lines one by one
_PIECE = 256  # lines that are parsed at once if all are valid


class UnreadableLineError(ValueError):
    """A line is not a row; the message says why."""


@dataclass
class GarbledLines:
    """Counts of lines that could not be parsed completely.

    Attributes
    ----------
    lines : int
        Number of lines.
    first : bytes
        The first of them.
    why : str
        Reason why the first could not be parsed.
    failure : InputError or None
        Why no later line can be parsed.
    """

    lines: int = 0
    first: bytes = b""
    why: str = ""
    failure: InputError | None = None

    def raise_failure(self) -> None:
        """Raise the failure, if there is one."""
        if self.failure is not None:
            raise self.failure

    def add(self, line: bytes, why: str) -> None:
        """Count a line."""
        if not self.lines:
            self.first, self.why = line, why
        self.lines += 1


@dataclass
class ParsedRows:
    """Rows parsed from lines.

    Attributes
    ----------
    values : list of (n, m) float arrays
        Readings.
    stamps : list of (n,) float arrays
        Stamps in seconds; empty if the lines have none.
    places : list of int
        Indices, from 0, of the lines that became rows, without blank lines and comments.
    lines : int
        Number of lines, without blank lines and comments.
    """

    values: list[Floats] = field(default_factory=list)
    stamps: list[Floats] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    lines: int = 0


class LineLayout(Protocol):
    """A layout of rows in lines."""

    columns: Columns
    has_rows: bool
    """True once a row was parsed; a header above the first row is none that changes anything."""

    def cells(self, line: bytes) -> Sequence[Cell]:
        """Return the cells of a line in the order of the columns; raise UnreadableLineError if it is not a row."""
        ...

    def parse_many(self, lines: Sequence[bytes]) -> tuple[Floats, Floats] | None:
        """Return values and stamps of many lines, parsed at once; None if any line is not plain and valid."""
        ...

    def take_header(self, line: bytes) -> None:
        """Follow a line that is not a row, if it is a header; raise InputError if its names or units are others."""
        ...

    def name_left_out(self) -> str:
        """Return, once, the name of a column that is no channel and had a number in a line; "" otherwise."""
        ...


class CsvLayout:
    """The layout of CSV: cells between separators.

    Numbers may have a decimal point or, if the separator is not a comma, a decimal comma; the first one decides,
    because 1,000 beside 0.999 is a thousand.

    Parameters
    ----------
    columns : Columns
        Columns of the rows.
    separator : str
        Separator of the cells; " " stands for runs of spaces, "" for a single cell.
    header : sequence of bytes
        The lines from which the names of the columns come, if they come from lines.
    """

    def __init__(self, columns: Columns, separator: str, header: Sequence[bytes] = ()) -> None:
        self.columns, self.separator = columns, separator
        self._header, self._first, self.has_rows = header, columns, False
        self._cut = None if separator == " " else separator.encode()
        self._commas = separator != ","  # True if a comma may be a decimal sign
        self._decimal = ""  # the decimal sign of the rows, once it is known
        self._left_out: str | None = None if columns.left_out else ""  # None while no number was left out

    def cells(self, line: bytes) -> Sequence[Cell]:
        """Return the cells of a line; raise UnreadableLineError if it is not a row."""
        try:
            text = line.decode("utf-8")
        except UnicodeDecodeError as cause:
            raise UnreadableLineError("it is not UTF-8 text") from cause
        cells = split(text, self.separator)
        width = len(self.columns.all_names)
        if len(cells) > width and not any(cell.strip() for cell in cells[width:]):  # trailing separators
            cells = cells[:width]
        if len(cells) != width:
            raise UnreadableLineError(f"it has {len(cells)} cell{'s' * (len(cells) != 1)}, not {width}")
        if self._left_out is None:
            numbers = (at for at in self.columns.left_out if kind_of(cells[at]) == NUMBER)
            self._left_out = next((self.columns.all_names[at] for at in numbers), None)
        return self._with_points(cells) if self._commas else cells

    def _with_points(self, cells: list[str]) -> list[str]:
        """Return cells with decimal points; raise UnreadableLineError if their decimal sign is not that of the rows."""
        signs = {decimal_of(cells[place]) for place in self._number_places()} - {""}
        if len(signs | {self._decimal} - {""}) > 1:
            raise UnreadableLineError("its numbers have commas and points, or others than earlier rows")
        self._decimal = next(iter(signs), self._decimal)
        return [cell.replace(",", ".") for cell in cells]

    def _number_places(self) -> tuple[int, ...]:
        """Return the indices of channels and numeric stamps."""
        stamp = self.columns.stamp_place if isinstance(self.columns.stamp_of, NumberStamps) else None
        return self.columns.places if stamp is None else (*self.columns.places, stamp)

    def parse_many(self, lines: Sequence[bytes]) -> tuple[Floats, Floats] | None:
        """Return values and stamps of many lines, parsed at once; None if any line is not plain and valid."""
        columns = self.columns
        rows = [[line] for line in lines] if self._cut == b"" else [line.split(self._cut) for line in lines]
        if set(map(len, rows)) != {len(columns.all_names)}:
            return None
        cells = list(zip(*rows, strict=True))
        if self._left_out is None:
            words = {cell for place in columns.left_out for cell in cells[place]}
            if any(kind_of(word.decode("utf-8", "replace")) == NUMBER for word in words):
                return None
        decimal = self._decimal
        if self._commas:
            numbers = b"".join(b"".join(cells[place]) for place in self._number_places())
            signs = {sign for sign in ".," if sign.encode() in numbers}
            if len(signs | {decimal} - {""}) > 1:
                return None
            decimal = next(iter(signs), decimal)
            if decimal == ",":
                cells = [tuple(cell.replace(b",", b".") for cell in column) for column in cells]
        try:
            values = numbers_of([cell for place in columns.places for cell in cells[place]])
            by_row = np.ascontiguousarray(values.reshape(-1, len(rows)).T)
            stamps = np.empty(0)
            if columns.stamp_place is not None and columns.stamp_of is not None:
                stamps = columns.stamp_of.parse_many(cells[columns.stamp_place])
        except ValueError:
            return None
        self._decimal = decimal
        return by_row, stamps

    def take_header(self, line: bytes) -> None:
        """Follow a header with the same names; raise InputError for one with other names or units.

        A line is a header if it has as many cells as a row, none empty or a number, and half of them name columns.
        """
        if not (self._header and self.has_rows) or (line in self._header and self.columns is self._first):
            return
        cells = [cell.strip() for cell in split(line.decode("utf-8", "replace").lstrip("#%/ "), self.separator)]
        names, known = unique_names(cells), self.columns.all_names
        if sorted(names) == sorted(known):
            self.columns = self._first.reordered(names)
            return
        bare = {parse_header(name)[0] for name in known}
        alike = sum(parse_header(name)[0] in bare for name in names)
        if len(names) == len(known) <= 2 * alike and all(number_of(cell) is None for cell in cells):
            raise InputError(
                f"Among the lines is a header with other names or units: {', '.join(names)[:200]}; the first was"
                f" {', '.join(known)[:200]}. Clean the lines after it as another stream."
            )

    def name_left_out(self) -> str:
        """Return, once, the name of a column that is no channel and had a number in a line; "" otherwise."""
        name = self._left_out or ""
        self._left_out = "" if name else self._left_out
        return name


class JsonLayout:
    """The layout of JSON: one object per line. An absent name is a missing reading; other names are ignored.

    Parameters
    ----------
    columns : Columns
        Columns of the rows.
    is_open : bool
        True if all numbers should be channels, so that a number with another name must be reported.
    """

    def __init__(self, columns: Columns, *, is_open: bool = False) -> None:
        self.columns, self.has_rows = columns, False
        self._left_out: str | None = None if is_open else ""  # None while no number was left out

    def cells(self, line: bytes) -> Sequence[Cell]:
        """Return the values of an object; raise UnreadableLineError if it is not a row."""
        row = json_object(line)
        if row is None:
            raise UnreadableLineError("it is not a JSON object")
        columns = self.columns
        if not any(columns.all_names[place] in row for place in columns.places):
            raise UnreadableLineError("it has none of the channels")
        if self._left_out is None:
            others = (name for name in row if isinstance(row[name], float) and name not in columns.names)
            self._left_out = next((name for name in others if not is_time_name(name)), None)
        return [row.get(name) for name in columns.all_names]

    def parse_many(self, lines: Sequence[bytes]) -> None:
        """Return None, because objects are always parsed one by one."""
        return

    def take_header(self, line: bytes) -> None:
        """Do nothing, because each object names its values."""

    def name_left_out(self) -> str:
        """Return, once, the name of a number in an object that is no channel; "" otherwise."""
        name = self._left_out or ""
        self._left_out = "" if name else self._left_out
        return name


def json_object(line: bytes) -> dict[str, Cell] | None:
    """Return the JSON object of a line, with all numbers as floats; None if the line is not one."""
    if not line.lstrip().startswith(b"{"):
        return None
    try:
        value = json.loads(line, parse_int=float)
    except (ValueError, RecursionError):  # not JSON, not text, or nested too deeply
        return None
    return value if isinstance(value, dict) else None


def parse_lines(layout: LineLayout, lines: Sequence[bytes], bad: GarbledLines) -> ParsedRows:
    """Parse lines; skip blank lines and comments, and count the other lines that cannot be parsed in `bad`."""
    taken = ParsedRows()
    for start in range(0, len(lines), _PIECE):
        piece = lines[start : start + _PIECE]
        joined = b"".join(piece)
        parsed = None if any(mark in joined for mark in _NOT_PLAIN) else layout.parse_many(piece)
        if parsed is None:
            try:
                _parse_one_by_one(layout, piece, taken, bad)
            except InputError as failure:
                bad.failure = failure
                break
        else:
            taken.values.append(parsed[0])
            taken.stamps.append(parsed[1])
            taken.places += range(taken.lines, taken.lines + len(piece))
            taken.lines += len(piece)
            layout.has_rows = True
    return taken


def is_remark(line: bytes) -> bool:
    """Return whether a line is blank, or a comment that begins with #."""
    return line.lstrip()[:1] in (b"", b"#")


def _parse_one_by_one(layout: LineLayout, lines: Sequence[bytes], taken: ParsedRows, bad: GarbledLines) -> None:
    """Parse lines into `taken` and `bad`; raise InputError at a header with other names, after the lines above it."""
    rows, stamps = [], []
    try:
        for line in lines:
            if is_remark(line):
                layout.take_header(line)
                continue
            taken.lines += 1
            try:
                stamp, row, why = _row(layout, line)
            except UnreadableLineError as cause:
                layout.take_header(line)
                bad.add(line, str(cause))
                continue
            if not why and (name := layout.name_left_out()):
                why = f"{name!r} has a number but had none at first, and is left out: start again to clean it"
            if why:
                bad.add(line, why)
            layout.has_rows = True
            rows.append(row)
            taken.places.append(taken.lines - 1)
            if stamp is not None:
                stamps.append(stamp)
    finally:
        if rows:
            taken.values.append(np.array(rows))
            taken.stamps.append(np.array(stamps))


def _row(layout: LineLayout, line: bytes) -> tuple[float | None, list[float], str]:
    """Return stamp and readings of a line, and why one of the readings could not be parsed ("" if all could)."""
    columns, cells = layout.columns, layout.cells(line)
    numbers = [number_of(cells[place]) for place in columns.places]
    why = ""
    if None in numbers:
        place = columns.places[numbers.index(None)]
        why = f"{columns.all_names[place]!r} is not a number"
        if all(value is None or value != value for value in numbers):
            raise UnreadableLineError(why)
    stamp = None
    if columns.stamp_place is not None and columns.stamp_of is not None:
        try:
            stamp = columns.stamp_of.parse(cells[columns.stamp_place])
        except ValueError as cause:
            raise UnreadableLineError(f"{columns.all_names[columns.stamp_place]!r} is not a time") from cause
    return stamp, [np.nan if value is None else value for value in numbers], why
