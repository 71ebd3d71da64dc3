"""Lines of CSV and of JSON as rows of numbers, once it is known what their columns mean."""

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

_NOT_PLAIN = (b'"', b"#", b"(")  # quotes, remarks, nan(1): read one by one
_PIECE = 256  # lines that are read at once where all of them are well


class UnreadableLineError(ValueError):
    """A line that is no row, and why."""


@dataclass
class Bad:
    """Lines that could not be read, or not wholly.

    Attributes
    ----------
    lines : int
        How many.
    first : bytes
        The first of them.
    why : str
        What is wrong with it.
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
class Taken:
    """What was read of some lines.

    Attributes
    ----------
    values : list of (n, m) float arrays
        Readings.
    stamps : list of (n,) float arrays
        In seconds; empty where lines have none.
    places : list of int
        Which of the lines became rows, counted from 0.
    lines : int
        How many lines there were that could have been.
    """

    values: list[Floats] = field(default_factory=list)
    stamps: list[Floats] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    lines: int = 0


class LineLayout(Protocol):
    """How rows are written."""

    columns: Columns

    def cells(self, line: bytes) -> Sequence[Cell]:
        """Cut a line into its cells, in the order of the columns; UnreadableError if it is no row."""
        ...

    def well(self, lines: Sequence[bytes]) -> tuple[Floats, Floats] | None:
        """Read many lines at once, if nothing is wrong with any."""
        ...


class CsvLayout:
    """Rows as cells between separators.

    Parameters
    ----------
    columns : Columns
        What the cells mean.
    separator : str
        Between two cells; " " stands for runs of spaces, "" for one cell.
    """

    def __init__(self, columns: Columns, separator: str) -> None:
        self.columns, self.separator = columns, separator
        self._cut = None if separator == " " else separator.encode()
        self._commas = separator != ","  # which can be decimal signs

    def cells(self, line: bytes) -> Sequence[Cell]:
        """Cut a line into its cells."""
        try:
            text = line.decode("utf-8")
        except UnicodeDecodeError as cause:
            raise UnreadableLineError("it is no text") from cause
        cells = split(text, self.separator)
        width = len(self.columns.all_names)
        if len(cells) > width and not any(cell.strip() for cell in cells[width:]):  # separators that trail
            cells = cells[:width]
        if len(cells) != width:
            raise UnreadableLineError(f"it has {len(cells)} cell{'s' * (len(cells) != 1)}, not {width}")
        return [cell.replace(",", ".") for cell in cells] if self._commas else cells

    def well(self, lines: Sequence[bytes]) -> tuple[Floats, Floats] | None:
        """Read many lines at once, if nothing is wrong with any."""
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
            return by_row, columns.stamp_of.many(cells[columns.stamp_place])
        except ValueError:
            return None


class JsonLayout:
    """Rows as JSON objects, one a line; a name that is not there is a missing reading, others are left out.

    Parameters
    ----------
    columns : Columns
        What the names mean.
    """

    def __init__(self, columns: Columns) -> None:
        self.columns = columns

    def cells(self, line: bytes) -> Sequence[Cell]:
        """Pick the values of an object."""
        told = json_object(line)
        if told is None:
            raise UnreadableLineError("it is no JSON object")
        columns = self.columns
        if not any(columns.all_names[place] in told for place in columns.places):
            raise UnreadableLineError("it has none of the channels")
        return [told.get(name) for name in columns.all_names]

    def well(self, lines: Sequence[bytes]) -> None:
        """Leave it to `cells`: objects are read one by one in any case."""
        return


def json_object(line: bytes) -> dict[str, Cell] | None:
    """Read a JSON object, all of its numbers as floats; None if the line holds none."""
    if not line.lstrip().startswith(b"{"):
        return None
    try:
        told = json.loads(line, parse_int=float)
    except (ValueError, RecursionError):  # no JSON, no text, or too deep
        return None
    return told if isinstance(told, dict) else None


def take(layout: LineLayout, lines: Sequence[bytes], bad: Bad) -> Taken:
    """Read lines; blank ones and remarks are left out, and whatever else cannot be read is counted."""
    taken = Taken()
    for start in range(0, len(lines), _PIECE):
        piece = lines[start : start + _PIECE]
        joined = b"".join(piece)
        well = None if any(mark in joined for mark in _NOT_PLAIN) else layout.well(piece)
        if well is None:
            _take_one_by_one(layout, [line for line in piece if not is_remark(line)], taken, bad)
            continue
        taken.values.append(well[0])
        taken.stamps.append(well[1])
        taken.places += range(taken.lines, taken.lines + len(piece))
        taken.lines += len(piece)
    return taken


def is_remark(line: bytes) -> bool:
    """Whether a line is blank, or a remark that begins with #."""
    return line.lstrip()[:1] in (b"", b"#")


def _take_one_by_one(layout: LineLayout, lines: Sequence[bytes], taken: Taken, bad: Bad) -> None:
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
    """Return stamp, readings, and what is wrong with one of them."""
    columns, cells = layout.columns, layout.cells(line)
    read = [number_of(cells[place]) for place in columns.places]
    why = ""
    if None in read:
        place = columns.places[read.index(None)]
        why = f"{columns.all_names[place]!r} is no number"
        if all(value is None or value != value for value in read):
            raise UnreadableLineError(why)
    stamp = None
    if columns.stamp_place is not None and columns.stamp_of is not None:
        try:
            stamp = columns.stamp_of.one(cells[columns.stamp_place])
        except ValueError as cause:
            raise UnreadableLineError(f"{columns.all_names[columns.stamp_place]!r} is no time") from cause
    return stamp, [np.nan if value is None else value for value in read], why
