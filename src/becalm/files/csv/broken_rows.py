"""Find the row of a CSV file that cannot be parsed: with an unclosed quote, or with the wrong number of cells."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.errors import InputError
from becalm.files.csv.sniffing import Dialect
from becalm.files.decoding import without_open_line
from becalm.files.source import RawTable
from becalm.files.text.cells import MISSING_CELL, WORDS, is_left_open, is_row, kind_of, split

Body = Callable[[], Iterable[bytes]]
"""A function that returns the rows of data in blocks of whole lines; it can be called several times."""

_LONGEST_CELL = 64 << 20  # bytes of a quoted cell; a longer one counts as never closed
_SHOWN = 60  # characters of a line in a message
_LINE_END = re.compile(rb"\r\n|\n|\r")


class _Patterns(NamedTuple):
    """Regular expressions for the rows and cells of a text with a given separator.

    Attributes
    ----------
    row : re.Pattern
        A row with its line end.
    quoted : re.Pattern
        A quoted cell, closed or not. Only a quote at the start of a cell opens it.
    to_spanning : re.Pattern
        The text up to the end of the next quoted `cell` that spans several lines; `behind` is the text between its
        closing quote and the next separator or line end.
    """

    row: re.Pattern[bytes]
    quoted: re.Pattern[bytes]
    to_spanning: re.Pattern[bytes]


class _Row(NamedTuple):
    """A row of the body."""

    number: int  # counted from 1
    line: int  # its first line in the body, counted from 0
    end: int  # position of its end in the body, in bytes
    text: bytes  # without its line end


class _Cell(NamedTuple):
    """A quoted cell that spans several lines; positions are in bytes."""

    start: int  # position of its opening quote
    line: int  # position of the beginning of the line with this quote
    lines: list[bytes]  # the lines that it spans, as whole lines
    behind: bytes | None  # text after its closing quote; None if the cell is not closed


class _StrayQuote(NamedTuple):
    """A quote that opens a cell by mistake."""

    at: int  # position in the body, in bytes
    line: bytes  # the line that holds it
    defect: str  # what is wrong with the cell that it opens, as the end of a sentence


def spans_lines(table: pa.Table) -> bool:
    """Return whether a cell of text contains a line end; only then can there be a stray quote."""
    texts = (column for column in table.columns if pa.types.is_string(column.type))
    return any(_has_line_end(chunk.buffers()[2]) for column in texts for chunk in column.chunks)


def _has_line_end(buffer: pa.Buffer | None) -> bool:
    data = np.frombuffer(buffer or b"", np.uint8)
    return bool((data == ord("\n")).any() or (data == ord("\r")).any())


def refuse_strays(path: Path, body: Body, dialect: Dialect) -> None:
    """Refuse a quoted cell that contains whole rows, or is never closed.

    Raises
    ------
    InputError
        If there is such a cell.
    """
    if _first_stray(body(), dialect):
        raise parse_error(path, body, dialect, "")


def parse_error(path: Path, body: Body, dialect: Dialect, cause: str) -> InputError:
    """Return the error for a text that pyarrow cannot parse.

    It names the first row with a stray quote or with a wrong number of cells; else it gives `cause`, pyarrow's message.
    """
    stray = _first_stray(body(), dialect)
    width = len(dialect.kinds)
    for row in _rows(body() if stray is None else _first_bytes(body(), stray.at + 1), dialect.separator):
        line = dialect.first_line + 1 + row.line
        if stray and row.end > stray.at:
            return _stray_quote_error(path, row.number, line + _line_ends(row.text), stray)
        if (cells := _cells(row.text, dialect.separator)) != width:
            return InputError(
                f"Row {row.number} (line {line}) of {path} has {cells} cell{'s' * (cells != 1)} where {width} are"
                f" needed: {_shown(row.text)}. Correct or remove that line."
            )
    return InputError(f"{path} cannot be read as a table: {' '.join(cause.split())[:200]}. Save it again as plain CSV.")


def _stray_quote_error(path: Path, number: int, line: int, stray: _StrayQuote) -> InputError:
    return InputError(
        f"Row {number} (line {line}) of {path} opens a quoted cell that {stray.defect}: {_shown(stray.line)}."
        " Remove that quote, or close the cell with another; a cell that is meant to hold all this must be on one line."
    )


def _shown(text: bytes) -> str:
    return repr(text.decode("utf-8")[:_SHOWN])


def _line_ends(text: bytes) -> int:
    return len(_LINE_END.findall(text))


def _rows(blocks: Iterable[bytes], separator: str) -> Iterator[_Row]:
    """Yield the rows of a body; a blank line counts as a row only if the table has a single column."""
    number, line, end, held = 0, 0, 0, b""
    for block in chain(blocks, (b"",)):
        data, held = held + block, b""
        for match in _patterns(separator).row.finditer(data):
            if block and match.end() == len(data):  # the row may continue in the next block
                held = match[0]
                break
            end += len(match[0])
            number += bool(match["cells"] or (match[0] and not separator))
            if match["cells"]:
                yield _Row(number, line, end, match["cells"])
            line += _line_ends(match[0])


def _cells(row: bytes, separator: str) -> int:
    return _patterns(separator).quoted.sub(b"", row).count(_delimiter(separator)) + 1


def _first_bytes(blocks: Iterable[bytes], size: int) -> Iterator[bytes]:
    """Yield blocks up to a total of `size` bytes."""
    for block in blocks:
        yield block[:size]
        size -= len(block)
        if size <= 0:
            return


def _first_stray(blocks: Iterable[bytes], dialect: Dialect) -> _StrayQuote | None:
    held, done = b"", 0
    for block in chain(blocks, (b"",)):
        data, held = held + block, b""
        for cell in _spanning(data, dialect.separator):
            may_continue = bool(block) and len(data) - cell.line < _LONGEST_CELL
            if defect := _defect_of_cell(cell, dialect, may_continue):
                return _StrayQuote(done + cell.start, cell.lines[0], defect)
            if cell.behind is None:
                held = data[cell.line :]
        done += len(data) - len(held)
    return None


def _spanning(data: bytes, separator: str) -> Iterator[_Cell]:
    """Yield the quoted cells that span several lines; `data` starts with a line that is not inside a quoted cell."""
    for match in _patterns(separator).to_spanning.finditer(data):
        if match["cell"] is None:
            continue
        start = match.start("cell")
        line = max(data.rfind(end, match.start(), start) + 1 for end in (b"\n", b"\r")) or match.start()
        after = _LINE_END.search(data, match.end())
        text = data[line : after.start() if after else len(data)]
        yield _Cell(start, line, _LINE_END.split(text), match["behind"])


def _defect_of_cell(cell: _Cell, dialect: Dialect, may_continue: bool) -> str:
    """Return what is wrong with a quoted cell of several lines, as the end of a sentence; "" if it is plausible.

    The line that the cell shares with other cells of its row is not tested, because it looks like a row. It is the last
    line if the cell is the first of its row, otherwise the first line.
    """
    own = cell.lines[:-1] if cell.start == cell.line else cell.lines[1:]
    if any(is_row(line.decode("utf-8"), dialect.separator, dialect.kinds) for line in own):
        return "includes lines that look like rows of their own"
    if cell.behind is None:
        return "" if may_continue else "is never closed"
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


# Detect and leave out an incomplete last line of a text, as it remains when a logger is stopped.

_WINDOW_BYTES = 1 << 20  # end of the text that is examined
_COMPARED_ROWS = 1000  # most lines of it that are examined
_ENOUGH_ROWS = 10  # rows above that are needed to judge the length of a last cell; an empty cell needs none
_RARE = 200  # a last cell is too short if at most one in this many cells above is as short
_SIGN = re.compile(r"^[+-]|(?<=[eE])[+-]")  # the signs of a number and of its exponent


class LastLine:
    """A filter of text that leaves out the last row of a table if it is incomplete.

    A last line without a line end is legal. It is incomplete if cells are missing, a quote is not closed, or the last
    cell is shorter than those above it.

    Parameters
    ----------
    dialect : Dialect
        The layout of the table.

    Attributes
    ----------
    defect : str
        What is wrong with the last line; "" if it is complete, or if not all lines were yielded yet.
    """

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self.defect = ""

    def whole_rows(self, blocks: Iterable[bytes]) -> Iterator[bytes]:
        """Yield the rows of data without the lines above them, and without an incomplete last row.

        Parameters
        ----------
        blocks : iterable of bytes
            Whole lines of UTF-8; the last line may have no line end.
        """
        offset, held, window = self._dialect.offset, b"", b""
        for block in blocks:
            if held:
                yield held
            held, offset = block[offset:], max(0, offset - len(block))
            window = (window + held[-_WINDOW_BYTES:])[-_WINDOW_BYTES:]
        self.defect = self._defect_of(window)
        yield without_open_line(held) if self.defect else held

    def _defect_of(self, window: bytes) -> str:
        lines = window.splitlines()[len(window) == _WINDOW_BYTES :]  # the window may begin within a line
        lines = lines[-_COMPARED_ROWS:]
        if len(lines) < 2 or window.endswith((b"\n", b"\r", b"\x1a")):
            return ""
        separator, width = self._dialect.separator, len(self._dialect.kinds)
        *above, last = (line.decode("utf-8") for line in lines)
        rows = [row for row in (split(line, separator) for line in above) if len(row) == width]
        cells = split(last, separator)
        if len(cells) > width or not self._is_beginning(cells, rows):
            return ""
        if is_left_open(last, separator):
            return "its last cell is not closed"
        if last.count('"') % 2:  # the line closes a cell that began above
            return ""
        if len(cells) < width:
            return f"it has {len(cells)} of {width} cells"
        enough = len(rows) >= _ENOUGH_ROWS or kind_of(cells[-1]) == MISSING_CELL
        if enough and _is_short(cells[-1], [row[-1] for row in rows], self._dialect.kinds[-1]):
            return f"it has no line end, and its last cell, {cells[-1]!r}, is shorter than those above"
        return ""

    def _is_beginning(self, cells: Sequence[str], rows: Sequence[Sequence[str]]) -> bool:
        """Return whether a line can be the beginning of a row, and not a remark below the table."""
        if not cells or not rows:
            return False
        kinds = self._dialect.kinds[: len(cells)]
        if any(kind != WORDS and kind_of(cell) == WORDS for cell, kind in zip(cells[:-1], kinds, strict=False)):
            return False
        own = _shape(cells[-1], kinds[-1])[0]
        return (
            kinds[-1] == WORDS
            or kind_of(cells[-1]) != WORDS
            or any(_shape(row[len(cells) - 1], kinds[-1])[0].startswith(own) for row in rows)
        )


def _is_short(cell: str, above: Sequence[str], kind: str) -> bool:
    """Return whether hardly any cell above is as short as this one, and a longer cell above begins like it."""
    own, digits = _shape(cell, kind)
    shapes = [_shape(other, kind) for other in above]
    as_short = sum(shape == own and its <= digits for shape, its in shapes)
    return as_short * _RARE <= len(above) and any(
        shape.startswith(own) and (shape != own or its > digits) for shape, its in shapes
    )


def _shape(cell: str, kind: str) -> tuple[str, int]:
    """Return the shape of a cell and the number of digits at its end.

    In the shape of a number or a time, each run of digits is a 0; words are returned unchanged, with 0 digits.
    """
    if kind == WORDS:
        return cell, 0
    plain = _SIGN.sub("", cell.strip())
    return re.sub(r"[0-9]+", "0", plain), len(plain) - len(plain.rstrip("0123456789"))


def with_truncation_notes(table: RawTable, cut: str, last: LastLine) -> RawTable:
    """Add notes to a table if its text is incomplete.

    Parameters
    ----------
    table : RawTable
        All complete rows.
    cut : str
        A sentence that says that the file is truncated; "" if it is not.
    last : LastLine
        The examined last line.
    """
    notes = [cut] if cut else []
    if last.defect:
        place = table.place(table.count)
        notes.append(f"The last line, {place}, is cut short ({last.defect}) and left out; the file is incomplete.")
    return replace(table, notes=(*table.notes, *notes))
