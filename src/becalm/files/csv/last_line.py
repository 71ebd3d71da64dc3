"""Detect and leave out an incomplete last line of a text, as it remains when a logger is stopped."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from becalm.files.csv.sniffing import Dialect
from becalm.files.decoding import without_open_line
from becalm.files.source import RawTable
from becalm.files.text.cells import GONE, WORDS, is_left_open, kind_of, split

_WINDOW_BYTES = 1 << 20
_COMPARED_ROWS = 1000
_ENOUGH_ROWS = 10  # rows needed to judge the length of the last cell; any number of rows shows if it may be empty
_RARE = 200  # a last cell is too short if no more than one in so many above is as short
_SIGN = re.compile(r"^[+-]|(?<=[eE])[+-]")


class LastLine:
    """Leave out the last row of a table if it is incomplete.

    A last line without a line end is legal. It is incomplete if cells are missing, a quote is not closed, or the last
    cell is shorter than those above it.

    Parameters
    ----------
    dialect : Dialect
        The layout of the table.

    Attributes
    ----------
    harm : str
        What is wrong with the last line; "" if it is complete, and until all lines were yielded.
    """

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self.harm = ""

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
        self.harm = self._harm_of(window)
        yield without_open_line(held) if self.harm else held

    def _harm_of(self, window: bytes) -> str:
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
        if last.count('"') % 2:  # it closes a cell that began above
            return ""
        if len(cells) < width:
            return f"it has {len(cells)} of {width} cells"
        enough = len(rows) >= _ENOUGH_ROWS or kind_of(cells[-1]) == GONE
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
    """Return whether hardly any cell above is as short as this one, and some continue where it ends."""
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
    if last.harm:
        place = table.place(table.count)
        notes.append(f"The last line, {place}, is cut short ({last.harm}) and left out; the file is incomplete.")
    return replace(table, notes=(*table.notes, *notes))
