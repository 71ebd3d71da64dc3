"""Find the sets of a universal file, and read their numbers."""

from __future__ import annotations

import re
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Floats

_HEAD_LINES = 12  # lines of a set's header; the first of them has the number of the set's type
_LONGEST = 400  # largest number of bytes in such a line; 80 is usual
_SIZE = slice(31, 43)  # columns in the first header line of a binary set: the size of its numbers in bytes
_LINE = re.compile(rb"^ {0,5}-1 *\r?(?:\n|\Z)", re.MULTILINE)  # a mark: a line with -1, usually indented by four
_MARK = re.compile(rb" {4}-1 *\r?(?:\n|\Z)")  # a mark anywhere, after binary numbers of unknown size
_AFTER_NUMBERS = re.compile(rb"[\r\n ]*?-1 *\r?(?:\n|\Z)")  # a mark after binary numbers of known size


class Values(NamedTuple):
    """The numbers of a set, paired with times if these are uneven.

    Attributes
    ----------
    pairs : (N,) or (N, 2) array
        The numbers in the order and type of the file.
    complete : bool
        Whether there are as many numbers as the header states.
    """

    pairs: NDArray[np.generic]
    complete: bool

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        return len(self.pairs)

    def ordinate(self, first: int, last: int) -> Floats:
        """Return the signal, (last - first,)."""
        return self._column(first, last, 1)

    def abscissa(self, first: int, last: int) -> Floats:
        """Return the times, (last - first,), in the unit of the file."""
        return self._column(first, last, 0)

    def _column(self, first: int, last: int, number: int) -> Floats:
        part = self.pairs[first:last]
        if part.ndim == 2:
            part = part[:, number]
        return np.asarray(part).astype(np.float64)


class UffBlock(NamedTuple):
    """A set 58: its header, and the place of its numbers.

    Attributes
    ----------
    head : bytes
        The twelve lines of its header.
    start, stop : int
        Byte range of its numbers in the file; `stop` is the next mark, or the end of the file.
    """

    head: bytes
    start: int
    stop: int

    def values(self, path: Path, header: dict[str, Any]) -> Values:
        """Return the numbers of the set; `header` is its parsed header."""
        promised, uneven = max(header["num_pts"], 0), not header["abscissa_spacing"]
        if not header["binary"]:
            with path.open("rb") as file:
                file.seek(self.start)
                return _of_text(file.read(self.stop - self.start), header["ord_data_type"] == 4, uneven, promised)
        kind = np.dtype(
            ("<" if header["byte_ordering"] == 1 else ">") + ("f4" if header["ord_data_type"] == 2 else "f8")
        )
        width = 2 if uneven else 1
        rows = min(promised, (self.stop - self.start) // (width * kind.itemsize))
        shape = (rows, width) if uneven else (rows,)
        held = np.memmap(path, kind, "r", self.start, shape) if rows else np.empty(shape, kind)
        return Values(held, rows == promised)


def blocks_of(path: Path) -> tuple[list[UffBlock], bool]:
    """Return all sets 58 of a file, and whether it ends within the header of one."""
    blocks: list[UffBlock] = []
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
        at = 0
        while mark := _LINE.search(data, at):
            first = _lines(data, mark.end(), 1)
            if first[:6].strip() != b"58":
                closing = _LINE.search(data, mark.end())
                at = closing.end() if closing else len(data)
                continue
            head = _lines(data, mark.end(), _HEAD_LINES)
            begin = mark.end() + len(head)
            if head.count(b"\n") < _HEAD_LINES:
                return blocks, True
            stop, at = _numbers(data, begin, first)
            blocks.append(UffBlock(head, begin, stop))
    return blocks, False


def _lines(data: mmap, at: int, count: int) -> bytes:
    lines = data[at : at + count * _LONGEST].splitlines(keepends=True)
    return b"".join(lines[:count])


def _numbers(data: mmap, begin: int, first: bytes) -> tuple[int, int]:
    """Return the offset at which a set's numbers end, and the offset from which to search for the next set."""
    if first[6:7].lower() != b"b":
        closing = _LINE.search(data, begin)
        if closing is None:  # drop the last, truncated line, because its numbers may be wrong
            return max(data.rfind(b"\n", begin) + 1, begin), len(data)
        return closing.start(), closing.end()
    size = first[_SIZE].strip()
    stop = begin + int(size) if size.isdigit() else begin
    if stop > begin and (closing := _AFTER_NUMBERS.match(data, stop)):
        return stop, closing.end()
    closing = _MARK.search(data, begin)
    if closing is None:
        return len(data), len(data)
    return begin + len(data[begin : closing.start()].rstrip(b"\r\n ")), closing.end()


def _of_text(text: bytes, double: bool, uneven: bool, promised: int) -> Values:
    """Read numbers in columns of fixed width; if the lengths of lines do not fit, read numbers separated by blanks."""
    time, signal = 13, 20 if double else 13
    width = time + signal if uneven else signal
    lines = [line.rstrip() for line in text.replace(b"D", b"E").splitlines()]
    numbers: NDArray[np.float64]
    if any(len(line) % width for line in lines):
        numbers = np.array(b" ".join(lines).split(), np.float64)
    else:
        joined = b"".join(lines)
        if uneven and time != signal:
            pairs = np.frombuffer(joined, [("x", f"S{time}"), ("y", f"S{signal}")])
            numbers = np.stack([pairs["x"].astype(np.float64), pairs["y"].astype(np.float64)], axis=1).reshape(-1)
        else:
            numbers = np.frombuffer(joined, f"S{signal}").astype(np.float64)
    if uneven:
        numbers = numbers[: len(numbers) // 2 * 2].reshape(-1, 2)
    return Values(numbers[:promised], len(numbers) >= promised)
