"""Detect the layout of a CSV file from its first lines: separator, decimal separator and header."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from becalm.errors import InputError
from becalm.files.csv.rates import rate_above
from becalm.files.text.cells import (
    GROUPED,
    MISSING_CELL,
    NUMBER,
    TIME,
    WORDS,
    decimal_of,
    grouped_error,
    is_left_open,
    kind_of,
    split,
)
from becalm.files.text.csv_header import Header, find_header

_SEPARATORS = (";", "\t", ",", "|", "", " ")  # the first of equal scores wins; "" is a file of one column
_HEAD_BYTES = 65_536  # at least so many bytes of text are examined
_HEAD_LINES = 30  # and at least so many lines
_SCORED_LINES = 40  # lines by which separators are compared
_KIND_ROWS = 300  # rows that decide the kind of a column
_LINE = re.compile(rb"([^\r\n]*)(\r\n|\n|\r|$)")
_COMMENT = ("#", "%", "//")  # how a comment begins


@dataclass(frozen=True)
class Dialect:
    """The layout of a table in a text.

    Attributes
    ----------
    separator : str
        The separator between two cells; " " for runs of spaces, "" for one column.
    decimal : str
        The decimal separator, "." or ","; "" if the first rows have no fractions.
    header : Header
        Names and units, and their place in the file.
    kinds : tuple of str
        "number", "time", "missing" or "words" for each column.
    first_line : int
        Line of the first row of data, counted from 0.
    offset : int
        Position of the first row of data, in bytes.
    """

    separator: str
    decimal: str
    header: Header
    kinds: tuple[str, ...]
    first_line: int
    offset: int


@dataclass(frozen=True)
class _Line:
    text: str
    offset: int

    @property
    def plain(self) -> bool:
        """Return whether the line can belong to the table: it is neither blank nor a comment."""
        stripped = self.text.strip()
        return bool(stripped) and not stripped.startswith(_COMMENT)


def sniff(path: Path, data: bytes) -> Dialect:
    """Detect the layout of a CSV file.

    Parameters
    ----------
    path : Path
        The file, for messages.
    data : bytes
        The text as UTF-8 without a byte-order mark.

    Raises
    ------
    InputError
        If there is no table of numbers, or the file can be read in two ways.
    """
    lines = _head(data)
    stated = re.match(r"^sep=([^\w\s\"]|\t)\s*$", lines[0].text, re.IGNORECASE) if lines else None
    start = 1 if stated else 0
    begin = max((number + 1 for number in range(start, len(lines)) if _ends_head(lines[number])), default=start)
    plain = [number for number in range(begin, len(lines)) if lines[number].plain]
    if not plain:
        raise InputError(f"{path} holds no table; a header and two or more rows of numbers are needed.")
    separator = stated[1] if stated else _separator(path, [lines[number].text for number in plain])
    cells = {number: split(lines[number].text, separator) for number in plain}
    width = _width([cells[number] for number in plain[len(plain) // 2 :]])
    body = [cells[number] for number in plain[-_KIND_ROWS:] if len(cells[number]) == width]
    kinds = _column_kinds(body, width)
    first = _first_row(path, plain, cells, kinds)
    _refuse_open_cells(path, {number: lines[number].text for number in plain if number < first}, separator, width)
    above = [line.text for line in lines[:first]]
    header = replace(find_header(above, start, separator, kinds), rate_hz=rate_above(above[start:], separator))
    _refuse_misfit(path, separator, header, width)
    data_rows = [cells[number] for number in plain if number >= first][:_KIND_ROWS]
    kinds = _column_kinds([row for row in data_rows if len(row) == width], width)
    decimal = _decimal(path, data_rows, kinds, separator)
    return Dialect(separator, decimal, header, kinds, first, lines[first].offset)


def _ends_head(line: _Line) -> bool:
    """Return whether a line ends the head of a LabVIEW file, which itself has columns of numbers."""
    return line.text.startswith(("***End_of_Header***", "delta t\t"))


def _head(data: bytes) -> list[_Line]:
    lines: list[_Line] = []
    for match in _LINE.finditer(data):
        if match.start() >= len(data) or (match.start() > _HEAD_BYTES and len(lines) >= _HEAD_LINES):
            break
        lines.append(_Line(match[1].decode("utf-8"), match.start()))
    if lines[-1:] and lines[0].text.startswith(";") and ";" not in lines[-1].text:  # comments of Gulf Coast loggers
        return [_Line(re.sub("^;", "#", line.text), line.offset) for line in lines]
    return lines


def _separator(path: Path, plain: Sequence[str]) -> str:
    """Return the separator that best splits the later lines into equal numbers of cells, most of them numbers."""
    later = plain[len(plain) // 2 :][:_SCORED_LINES]
    scores = {separator: _score(later, separator) for separator in _SEPARATORS}
    best = max(_SEPARATORS, key=lambda separator: scores[separator])
    if scores[best] == 0:
        raise InputError(f"{path} holds text but no column of numbers; a header and rows of numbers are needed.")
    if best == "," and scores[""] == scores[","]:
        return _one_or_two(path, plain)
    if best and not _has_names(plain, later, best):  # a column of lists may hold more numbers than all others
        named = [one for one in _SEPARATORS if one.strip() and scores[one] > 0 and _has_names(plain, later, one)]
        return max(named, key=lambda separator: scores[separator], default=best)
    return best


def _has_names(plain: Sequence[str], later: Sequence[str], separator: str) -> bool:
    """Return whether a separator splits a line above the data into words, one for each column."""
    width = _width([split(line, separator) for line in later])
    above = (split(line, separator) for line in plain[: len(plain) // 2])
    return any(len(row) == width and all(kind_of(cell) == WORDS for cell in row) for row in above)


def _score(lines: Sequence[str], separator: str) -> float:
    if separator and sum(separator in line.strip() for line in lines) * 2 < len(lines):
        return 0.0
    rows = [split(line, separator) for line in lines]
    width = _width(rows)
    if separator and width < 2:
        return 0.0
    fitting = [row for row in rows if len(row) == width]
    kinds = Counter(kind_of(cell) for row in fitting for cell in row)
    like = kinds[NUMBER] + kinds[TIME]
    return len(fitting) / len(rows) * like / max(1, like + kinds[WORDS])


def _one_or_two(path: Path, plain: Sequence[str]) -> str:
    """Decide with the header whether lines like `1,234` are one column with decimal commas, or two columns."""
    header = next((line for line in reversed(plain) if kind_of(line) != NUMBER), None)
    if header is None:
        raise InputError(
            f"{path} can be read as one column with decimal commas or as two columns: {plain[0].strip()!r}."
            " Put a line with the column names above, or write decimal points."
        )
    return "," if "," in header else ""


def _width(rows: Sequence[Sequence[str]]) -> int:
    counts = Counter(len(row) for row in rows)
    most = max(counts.values())
    return max(width for width, count in counts.items() if count == most)


def _column_kinds(rows: Sequence[Sequence[str]], width: int) -> tuple[str, ...]:
    kinds = []
    for column in range(width):
        counts = Counter(kind_of(row[column]) for row in rows)
        number, time, words = counts[NUMBER], counts[TIME], counts[WORDS]
        if not (number or time or words):
            kinds.append(MISSING_CELL)
        elif number >= max(time, words):
            kinds.append(NUMBER)
        else:
            kinds.append(TIME if time >= words else WORDS)
    return tuple(kinds)


def _first_row(path: Path, plain: Sequence[int], cells: dict[int, list[str]], kinds: tuple[str, ...]) -> int:
    """Return the line of the first row of data."""
    signals = [column for column, kind in enumerate(kinds) if kind in (NUMBER, TIME)]
    rows = [number for number in plain if _is_data(cells[number], signals, len(kinds))]
    if not signals or not rows:
        raise InputError(f"{path} has a header but no rows of numbers; two or more rows are needed.")
    first = rows[0]
    at = plain.index(first)
    if at == 0 and len(rows) > 1 and any(kind_of(cells[first][column]) == WORDS for column in signals):
        return rows[1]  # the first row is a header whose names are mostly numbers
    return plain[at - 1] if at >= 2 and _is_damaged(cells[plain[at - 2]], cells[plain[at - 1]], signals) else first


def _refuse_open_cells(path: Path, above: dict[int, str], separator: str, width: int) -> None:
    """Refuse an unclosed quote above the data, if its cell would contain the names or the first row."""
    for number, line in above.items():
        in_table = number == max(above) or line.count(separator or "\x1f") >= max(1, width - 1)
        if in_table and is_left_open(line, separator):
            raise InputError(
                f"Line {number + 1} of {path} opens a quoted cell and does not close it: {line[:60]!r}. Remove that"
                " quote, or close the cell with another; in the first row and above it, a cell must be on one line."
            )


def _is_damaged(above: Sequence[str], row: Sequence[str], signals: Sequence[int]) -> bool:
    """Return whether a row below the names is data with a bad cell: it has words and also numbers."""
    if len(above) != len(row) or not all(kind_of(cell) in (WORDS, MISSING_CELL) for cell in above):
        return False
    return len(row) > signals[-1] and any(kind_of(row[column]) in (NUMBER, TIME) for column in signals)


def _is_data(row: Sequence[str], signals: Sequence[int], width: int) -> bool:
    if len(row) != width:
        return False
    kinds = [kind_of(row[column]) for column in signals]
    good = sum(kind in (NUMBER, TIME) for kind in kinds)
    return good > kinds.count(WORDS)


def _refuse_misfit(path: Path, separator: str, header: Header, width: int) -> None:
    if separator == "," and header.given and width == 2 * header.given:
        raise InputError(
            f"{path} has {header.given} names in its header but {width} cells in each row: decimal commas in a file"
            " that is separated by commas. Save it with decimal points, or with ; between the columns."
        )
    if header.given and not header.fits:
        raise InputError(
            f"{path} has {header.given} names in its header but {width} cells in each row; one name a column is needed."
        )


def _decimal(path: Path, rows: Sequence[Sequence[str]], kinds: tuple[str, ...], separator: str) -> str:
    seen: dict[str, str] = {}
    grouped: dict[int, str] = {}  # by column, a number like 1,002
    whole: set[int] = set()  # columns with numbers below 1000 that have no comma
    others = False
    for row in rows:
        for column, (cell, kind) in enumerate(zip(row, kinds, strict=False)):
            if kind == NUMBER and (sign := decimal_of(cell)):
                seen.setdefault(sign, cell)
                if re.match(GROUPED, cell):
                    grouped.setdefault(column, cell)
                else:
                    others = True
            elif kind_of(cell) == NUMBER:
                whole.add(column)
    for column, cell in grouped.items():
        if not others and (separator == "," or column in whole):
            raise grouped_error(path, cell)
    if len(seen) > 1:
        raise InputError(
            f"{path} has decimal points ({seen['.'].strip()!r}) and decimal commas ({seen[','].strip()!r})."
            " Save all numbers with the same decimal separator."
        )
    return next(iter(seen), "")
