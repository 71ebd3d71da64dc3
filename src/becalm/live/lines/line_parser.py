"""Parse rows from lines of CSV or JSON that arrive in pieces, and count the lines that cannot be parsed."""

from __future__ import annotations

import time

import numpy as np

from becalm.core.arrays import Floats
from becalm.live.block import Block, Loss, LossKind
from becalm.live.lines.columns import LineOptions
from becalm.live.lines.layouts import layout_of, may_be_names
from becalm.live.lines.rows import GarbledLines, LineLayout, ParsedRows, is_remark, parse_lines

LONGEST_LINE = 1 << 20
"""Most bytes of a line; a longer line is counted as garbled, and not kept in memory."""

_LONGEST_FIRST = 1 << 16  # most bytes of a line while the layout is unknown
_MOST_ABOVE = 100  # most lines that are kept while the layout is unknown
_SHOWN = 60  # bytes of a line in a message
_SPREAD_S = 0.1  # longest time over which rows without stamps are spread
_TOO_LONG = "it is longer than 1 MB"
_MARK = "\N{BYTE ORDER MARK}".encode()  # some programs write it before a file of UTF-8


class LineParser:
    r"""A parser of lines that takes bytes in pieces of any size.

    A line ends with \n, \r\n or \r. Byte order marks are dropped. Blank lines and comments, which begin with #, are
    skipped. Other lines that are not rows are counted as garbled: noise, lines with too few or too many cells, repeated
    headers, lines over 1 MB, and rows whose stamp cannot be parsed. If a cell is not a number, its reading is missing,
    the other cells of the row are used, and the line is counted as garbled. An empty cell, or a spelling of NaN, is
    just a missing reading.

    A later header with the same names in another order moves the channels; one with other names or units is an error.
    A column that had no number in the first row is not a channel; once it has one, a loss says so.

    With a given rate, rows are stamped at this rate from the arrival of the first row, counting later garbled lines.
    Without a rate, stamps come from a column: seconds, counts since 1970, or ISO text. Without such a column, rows are
    spread evenly over the time since the previous piece, at most 0.1 s.

    Parameters
    ----------
    options : LineOptions
        Format, columns, time and rate of the lines.
    """

    def __init__(self, options: LineOptions) -> None:
        self._options = options
        self._half = bytearray()  # the incomplete last line
        self._skipping = False  # True up to the next line end
        self._starts_in_line = False  # True if the first line may be incomplete
        self._above: list[bytes] = []  # lines so far, while the layout is unknown
        self._layout: LineLayout | None = None
        self._bad = GarbledLines()
        self._counted = 0  # lines since the first row, if rows are stamped at a given rate
        self._began_s = 0.0  # arrival of the first row
        self._received_s = -np.inf  # arrival of the previous piece

    def feed(self, data: bytes, received_s: float) -> Block | None:
        """Parse the next bytes; return rows and losses, or None if there are none yet.

        Parameters
        ----------
        data : bytes
            Received bytes.
        received_s : float
            Time of their arrival, in seconds since 1970.

        Returns
        -------
        Block or None
            Rows and losses; the block has no names while the columns are unknown.

        Raises
        ------
        UsageError
            If the options do not fit the lines.
        InputError
            If a header before these bytes has other names or units than the first one.
        """
        self._bad.raise_failure()
        taken = self._parse(self._complete_lines(data))
        return self._block(taken, received_s)

    def finish(self, received_s: float) -> Block | None:
        """Parse the last bytes of the stream; a last line without a line end is garbled, unless it is a JSON object.

        Raises
        ------
        InputError
            If a header before these bytes has other names or units than the first one.
        """
        self._bad.raise_failure()
        last = bytes(self._half).replace(_MARK, b"")
        self._half.clear()
        is_json = last.lstrip().startswith(b"{") and last.rstrip().endswith(b"}")
        if last.strip() and not is_json:
            self._bad.add(last, "it has no line end and may be incomplete")
        taken = self._parse([last] if is_json else [])
        for line in self._above:
            self._count_unparsed(line)
        self._above = []
        return self._block(taken, received_s)

    def expect_partial_line(self) -> None:
        """Expect that the next bytes may begin within a line; the counting of rows starts again.

        That line is left out and not counted, unless the layout is unknown and the line contains only names.
        """
        self._half.clear()
        self._skipping, self._starts_in_line = False, True
        self._counted = 0

    def _complete_lines(self, data: bytes) -> list[bytes]:
        """Return the complete lines, without their line ends."""
        if self._skipping:
            ends = [at for at in (data.find(b"\n"), data.find(b"\r")) if at >= 0]
            if not ends:
                return []
            data, self._skipping = data[min(ends) + 1 :], False
        end = max(data.rfind(b"\n"), data.rfind(b"\r")) + 1
        complete = bytes(self._half) + data[:end] if end else b""
        if end:
            self._half.clear()
        self._half += data[end:]
        if len(self._half) > LONGEST_LINE:
            self._bad.add(bytes(self._half[: _SHOWN + 1]), _TOO_LONG)
            self._half.clear()
            self._skipping = True
        return complete.replace(_MARK, b"").replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")[:-1]

    def _parse(self, lines: list[bytes]) -> ParsedRows:
        if max(map(len, lines), default=0) > LONGEST_LINE:
            for line in lines:
                if len(line) > LONGEST_LINE:
                    self._bad.add(line[: _SHOWN + 1], _TOO_LONG)
            lines = [line for line in lines if len(line) <= LONGEST_LINE]
        if self._starts_in_line and lines:
            self._starts_in_line = False
            if self._layout is not None or not may_be_names(lines[0]):
                lines = lines[1:]
        if self._layout is None:
            lines = self._detect_layout(lines)
        if self._layout is None:
            return ParsedRows()
        return parse_lines(self._layout, list(filter(None, lines)), self._bad)

    def _detect_layout(self, lines: list[bytes]) -> list[bytes]:
        """Detect the layout of the lines; return the lines that can be parsed with it."""
        for at, line in enumerate(lines):
            if not line.strip():
                continue
            result = layout_of(self._above, line, self._options) if len(line) <= _LONGEST_FIRST else None
            if result is not None:
                self._layout, heading = result
                rest = [one for one in self._above if one not in heading] + lines[at:]
                self._above = []
                return rest
            self._above.append(line[:_LONGEST_FIRST])
            if len(self._above) > _MOST_ABOVE:
                self._count_unparsed(self._above.pop(0))
        return []

    def _count_unparsed(self, line: bytes) -> None:
        if not is_remark(line):
            self._bad.add(line, "no line above it has names for its cells")

    def _block(self, taken: ParsedRows, received_s: float) -> Block | None:
        count = len(taken.places)
        bad, self._bad = self._bad, GarbledLines(failure=self._bad.failure)
        time_s = self._times(taken, count, received_s)
        self._received_s = received_s
        if not (count or bad.lines):
            return None
        columns = None if self._layout is None else self._layout.columns
        names, units = ((), ()) if columns is None else (columns.names, columns.units)
        return Block(
            names,
            units,
            time_s,
            np.concatenate(taken.values) if count else np.empty((0, len(names))),
            losses=(_loss(bad),) if bad.lines else (),
            arrived_s=time.monotonic(),
        )

    def _times(self, taken: ParsedRows, count: int, received_s: float) -> Floats:
        stamps = np.concatenate(taken.stamps) if taken.stamps else np.empty(0)
        if len(stamps):
            return stamps
        if self._options.rate_hz is not None:
            if not self._counted:
                if not count:
                    return stamps
                self._began_s, self._counted = received_s, -taken.places[0]
            numbers = self._counted + np.array(taken.places)
            self._counted += taken.lines
            computed: Floats = self._began_s + numbers / self._options.rate_hz
            return computed
        if not count:
            return stamps
        start_s = received_s - _SPREAD_S
        if start_s < self._received_s < received_s:
            start_s = self._received_s
        spread: Floats = start_s + (received_s - start_s) * np.arange(1, count + 1) / count
        return spread


def _loss(bad: GarbledLines) -> Loss:
    shown = repr(bad.first[:_SHOWN].decode("utf-8", "replace")) + ("..." if len(bad.first) > _SHOWN else "")
    if bad.lines == 1:
        return Loss(LossKind.GARBLED, 1, f"A line could not be read completely: {shown}; {bad.why}.")
    lines = f"{bad.lines:,} lines could not be read completely"
    return Loss(LossKind.GARBLED, bad.lines, f"{lines}; the first is {shown}: {bad.why}.")
