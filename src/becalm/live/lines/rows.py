"""Parse lines of CSV or JSON into rows of numbers, once the columns are known."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from becalm.core.arrays import Floats
from becalm.files.text.cells import split
from becalm.live.lines.cells import Cell, number_of, numbers_of
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
    """

    lines: int = 0
    first: bytes = b""
    why: str = ""

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

    def cells(self, line: bytes) -> Sequence[Cell]:
        """Return the cells of a line in the order of the columns; raise UnreadableLineError if it is not a row."""
        ...

    def parse_many(self, lines: Sequence[bytes]) -> tuple[Floats, Floats] | None:
        """Return values and stamps of many lines, parsed at once; None if any line is not plain and valid."""
        ...


class CsvLayout:
    """The layout of CSV: cells between separators.

    Parameters
    ----------
    columns : Columns
        Columns of the rows.
    separator : str
        Separator of the cells; " " stands for runs of spaces, "" for a single cell.
    """

    def __init__(self, columns: Columns, separator: str) -> None:
        self.columns, self.separator = columns, separator
        self._cut = None if separator == " " else separator.encode()
        self._commas = separator != ","  # True if a comma is a decimal sign

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
        return [cell.replace(",", ".") for cell in cells] if self._commas else cells

    def parse_many(self, lines: Sequence[bytes]) -> tuple[Floats, Floats] | None:
        """Return values and stamps of many lines, parsed at once; None if any line is not plain and valid."""
        columns = self.columns
        if self._commas:
            lines = [line.replace(b",", b".") for line in lines]
        rows = [[line] for line in lines] if self._cut == b"" else [line.split(self._cut) for line in lines]
        if set(map(len, rows)) != {len(columns.all_names)}:
            return None
        cells = list(zip(*rows, strict=True))
        try:
            values = numbers_of([cell for place in columns.places for cell in cells[place]])
            by_row = np.ascontiguousarray(values.reshape(-1, len(rows)).T)
            if columns.stamp_place is None or columns.stamp_of is None:
                return by_row, np.empty(0)
            return by_row, columns.stamp_of.parse_many(cells[columns.stamp_place])
        except ValueError:
            return None


class JsonLayout:
    """The layout of JSON: one object per line. An absent name is a missing reading; other names are ignored.

    Parameters
    ----------
    columns : Columns
        Columns of the rows.
    """

    def __init__(self, columns: Columns) -> None:
        self.columns = columns

    def cells(self, line: bytes) -> Sequence[Cell]:
        """Return the values of an object; raise UnreadableLineError if it is not a row."""
        row = json_object(line)
        if row is None:
            raise UnreadableLineError("it is not a JSON object")
        columns = self.columns
        if not any(columns.all_names[place] in row for place in columns.places):
            raise UnreadableLineError("it has none of the channels")
        return [row.get(name) for name in columns.all_names]

    def parse_many(self, lines: Sequence[bytes]) -> None:
        """Return None, because objects are always parsed one by one."""
        return


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
            _parse_one_by_one(layout, [line for line in piece if not is_remark(line)], taken, bad)
            continue
        taken.values.append(parsed[0])
        taken.stamps.append(parsed[1])
        taken.places += range(taken.lines, taken.lines + len(piece))
        taken.lines += len(piece)
    return taken


def is_remark(line: bytes) -> bool:
    """Return whether a line is blank, or a comment that begins with #."""
    return line.lstrip()[:1] in (b"", b"#")


def _parse_one_by_one(layout: LineLayout, lines: Sequence[bytes], taken: ParsedRows, bad: GarbledLines) -> None:
    rows, stamps = [], []
    for place, line in enumerate(lines, taken.lines):
        try:
            stamp, row, why = _row(layout, line)
        except UnreadableLineError as cause:
            bad.add(line, str(cause))
            continue
        if why:
            bad.add(line, why)
        rows.append(row)
        taken.places.append(place)
        if stamp is not None:
            stamps.append(stamp)
    taken.lines += len(lines)
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
