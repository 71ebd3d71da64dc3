"""Rows of a CSV as they are written: which has a quote that does not close where it should, or a cell too many."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.errors import InputError
from becalm.files.csv.sniffing import Dialect
from becalm.files.text.cells import is_row

Body = Callable[[], Iterable[bytes]]
"""Gives the rows of data, in blocks of whole lines, as often as asked."""

_LONGEST_CELL = 64 << 20
_SHOWN = 60
_LINE_END = re.compile(rb"\r\n|\n|\r")


class _Patterns(NamedTuple):
    """What rows are made of.

    Attributes
    ----------
    row : re.Pattern
        A row with its line end.
    quoted : re.Pattern
        A quoted cell, closed or not; a quote opens it only where the cell begins.
    to_spanning : re.Pattern
        All up to the next quoted `cell` that goes beyond its line, and what stands `behind` its last quote.
    """

    row: re.Pattern[bytes]
    quoted: re.Pattern[bytes]
    to_spanning: re.Pattern[bytes]


class _Row(NamedTuple):
    """A row: counted from 1, its first line in the body counted from 0, where it ends, without its line end."""

    number: int
    line: int
    end: int
    text: bytes


class _Cell(NamedTuple):
    """A quoted cell that goes beyond its line: where its quote and that line begin, and the whole lines it touches.

    What stands behind its last quote is None where it is not closed.
    """

    start: int
    line: int
    lines: list[bytes]
    behind: bytes | None


class _Stray(NamedTuple):
    """A quote that should not open a cell: where it stands in the body, in which line, and what is wrong with it."""

    at: int
    line: bytes
    harm: str


def spans_lines(table: pa.Table) -> bool:
    """Tell whether a cell of text holds the end of a line; only then there is a stray quote to look for."""
    texts = (column for column in table.columns if pa.types.is_string(column.type))
    return any(_has_line_end(chunk.buffers()[2]) for column in texts for chunk in column.chunks)


def _has_line_end(buffer: pa.Buffer | None) -> bool:
    data = np.frombuffer(buffer or b"", np.uint8)
    return bool((data == ord("\n")).any() or (data == ord("\r")).any())


def refuse_strays(path: Path, body: Body, dialect: Dialect) -> None:
    """Refuse a quoted cell that takes whole rows into itself, or is never closed.

    Raises
    ------
    InputError
        If there is one.
    """
    if _first_stray(body(), dialect):
        raise ragged(path, body, dialect, "")


def ragged(path: Path, body: Body, dialect: Dialect, cause: str) -> InputError:
    """Find the first row with a stray quote or with another number of cells."""
    stray = _first_stray(body(), dialect)
    width = len(dialect.kinds)
    for row in _rows(body() if stray is None else _up_to(body(), stray.at + 1), dialect.separator):
        line = dialect.first_line + 1 + row.line
        if stray and row.end > stray.at:
            return _stray_quote(path, row.number, line + _line_ends(row.text), stray)
        if (cells := _cells(row.text, dialect.separator)) != width:
            return InputError(
                f"Row {row.number} (line {line}) of {path} has {cells} cell{'s' * (cells != 1)} where {width} are"
                f" needed: {_shown(row.text)}. Mend or remove that line."
            )
    return InputError(f"{path} cannot be read as a table: {' '.join(cause.split())[:200]}. Save it again as plain CSV.")


def _stray_quote(path: Path, number: int, line: int, stray: _Stray) -> InputError:
    return InputError(
        f"Row {number} (line {line}) of {path} opens a quoted cell that {stray.harm}: {_shown(stray.line)}."
        " Remove that quote, or close the cell with another; a cell that is meant to hold all this must be on one line."
    )


def _shown(text: bytes) -> str:
    return repr(text.decode("utf-8")[:_SHOWN])


def _line_ends(text: bytes) -> int:
    return len(_LINE_END.findall(text))


def _rows(blocks: Iterable[bytes], separator: str) -> Iterator[_Row]:
    """Cut a body into its rows; a blank line is one only where there is a single column."""
    number, line, end, held = 0, 0, 0, b""
    for block in chain(blocks, (b"",)):
        data, held = held + block, b""
        for found in _patterns(separator).row.finditer(data):
            if block and found.end() == len(data):  # it may go on in the next
                held = found[0]
                break
            end += len(found[0])
            number += bool(found["cells"] or (found[0] and not separator))
            if found["cells"]:
                yield _Row(number, line, end, found["cells"])
            line += _line_ends(found[0])


def _cells(row: bytes, separator: str) -> int:
    return _patterns(separator).quoted.sub(b"", row).count(_delimiter(separator)) + 1


def _up_to(blocks: Iterable[bytes], size: int) -> Iterator[bytes]:
    """Leave out what comes after so many bytes."""
    for block in blocks:
        yield block[:size]
        size -= len(block)
        if size <= 0:
            return


def _first_stray(blocks: Iterable[bytes], dialect: Dialect) -> _Stray | None:
    held, gone = b"", 0
    for block in chain(blocks, (b"",)):
        data, held = held + block, b""
        for cell in _spanning(data, dialect.separator):
            may_go_on = bool(block) and len(data) - cell.line < _LONGEST_CELL
            if harm := _harm(cell, dialect, may_go_on):
                return _Stray(gone + cell.start, cell.lines[0], harm)
            if cell.behind is None:
                held = data[cell.line :]
        gone += len(data) - len(held)
    return None


def _spanning(data: bytes, separator: str) -> Iterator[_Cell]:
    """Find the quoted cells that go beyond their line, in whole lines that begin outside of quotes."""
    for found in _patterns(separator).to_spanning.finditer(data):
        if found["cell"] is None:
            continue
        start = found.start("cell")
        line = max(data.rfind(end, found.start(), start) + 1 for end in (b"\n", b"\r")) or found.start()
        after = _LINE_END.search(data, found.end())
        text = data[line : after.start() if after else len(data)]
        yield _Cell(start, line, _LINE_END.split(text), found["behind"])


def _harm(cell: _Cell, dialect: Dialect, may_go_on: bool) -> str:
    """Say what a quoted cell of several lines does that none should do, "" for nothing.

    What stands before the cell, or behind it, makes its first line, or its last, look like a row in any case.
    """
    own = cell.lines[:-1] if cell.start == cell.line else cell.lines[1:]
    if any(is_row(line.decode("utf-8"), dialect.separator, dialect.kinds) for line in own):
        return "takes in lines which look like rows of their own"
    if cell.behind is None:
        return "" if may_go_on else "is never closed"
    return f"is closed below in the middle of a cell, before {_shown(cell.behind)}" if cell.behind.strip() else ""


def _delimiter(separator: str) -> bytes:
    return (separator or "\x1f").encode()


@cache
def _patterns(separator: str) -> _Patterns:
    delimiter = re.escape(_delimiter(separator))
    end = delimiter + rb"\r\n"
    plain = rb"[^%b]*+" % end
    opening = rb'"(?<![^%b]")' % end
    literal = rb'"(?<=[^%b]")' % end
    within = rb'[^"]*+(?:""[^"]*+)*+'
    in_line = rb'[^"\r\n]*+(?:""[^"\r\n]*+)*+"(?!")'
    cell = rb'(?:"%b"?+)?+%b' % (within, plain)
    return _Patterns(
        row=re.compile(rb"(?P<cells>%b(?:%b%b)*+)(?:\r\n|\n|\r|\Z)" % (cell, delimiter, cell)),
        quoted=re.compile(rb'%b%b"?+' % (opening, within)),
        to_spanning=re.compile(
            rb'(?:[^"]++|%b%b|%b)*+(?P<cell>"%b(?:"(?P<behind>%b)|\Z))?' % (opening, in_line, literal, within, plain)
        ),
    )
