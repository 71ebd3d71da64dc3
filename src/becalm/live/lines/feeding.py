"""Rows from lines of CSV or JSON that come in pieces, with whatever else comes between them."""

from __future__ import annotations

import time

import numpy as np

from becalm.core.arrays import Floats
from becalm.live.block import Block, Loss, LossKind
from becalm.live.lines.columns import LineOptions
from becalm.live.lines.layouts import layout_of, may_be_names
from becalm.live.lines.rows import Bad, LineLayout, Taken, is_remark, take

LONGEST_LINE = 1 << 20
"""Bytes of a line; whatever is longer is garbage, and not held."""

_LONGEST_FIRST = 1 << 16  # before it is known how lines are written
_MOST_ABOVE = 100
_SHOWN = 60
_SPREAD_S = 0.1
_TOO_LONG = "it is longer than 1 MB"


class Lines:
    r"""Makes rows of bytes, however these are cut.

    A line ends with \n, \r\n or \r. Blank lines and remarks, which begin with #, are left out; whatever else is no row
    is counted as garbled: noise, lines with too few or too many cells, names that come again, lines over 1 MB, and a
    row whose stamp cannot be read. A cell that is no number is a missing reading in a row that is taken, and its line
    is counted; an empty cell, or NaN in its many spellings, is a missing reading and nothing more.

    Stamps are what a column tells: seconds, counts since 1970, ISO text. Where none does, rows are counted from the
    first one's arrival at the rate that was told, garbled lines with them; or they are spread evenly over the time
    since the piece before them came, 0.1 s at most.

    Parameters
    ----------
    options : LineOptions
        What was said of the lines.
    """

    def __init__(self, options: LineOptions) -> None:
        self._options = options
        self._half = bytearray()
        self._skipping = False  # up to the next line end
        self._within = False  # the first line may be the end of one
        self._above: list[bytes] = []
        self._layout: LineLayout | None = None
        self._bad = Bad()
        self._counted = 0
        self._began_s = 0.0
        self._came_s = -np.inf

    def feed(self, data: bytes, came_s: float) -> Block | None:
        """Take the next bytes; return rows and losses, or None where there are none yet.

        Parameters
        ----------
        data : bytes
            As they came.
        came_s : float
            When, in seconds since 1970.

        Returns
        -------
        Block or None
            Without names where lines were lost before it was known what they hold.

        Raises
        ------
        UsageError
            If what was said of the lines does not fit them.
        """
        taken = self._taken(self._whole_lines(data))
        return self._block(taken, came_s)

    def finish(self, came_s: float) -> Block | None:
        """Hear that no more comes: a last line without its end may be cut short, and is counted, unless it is JSON."""
        last = bytes(self._half)
        self._half.clear()
        whole = last.lstrip().startswith(b"{") and last.rstrip().endswith(b"}")
        if last.strip() and not whole:
            self._bad.add(last, "it has no line end and may be cut short")
        taken = self._taken([last] if whole else [])
        for line in self._above:
            self._give_up(line)
        self._above = []
        return self._block(taken, came_s)

    def begin_within(self) -> None:
        """Hear that the next bytes may begin within a line; what was counted begins anew.

        That line is left out and not counted, unless names are awaited and it holds nothing else.
        """
        self._half.clear()
        self._skipping, self._within = False, True
        self._counted = 0

    def _whole_lines(self, data: bytes) -> list[bytes]:
        """Return the lines that have come wholly, without their ends."""
        if self._skipping:
            ends = [at for at in (data.find(b"\n"), data.find(b"\r")) if at >= 0]
            if not ends:
                return []
            data, self._skipping = data[min(ends) + 1 :], False
        end = max(data.rfind(b"\n"), data.rfind(b"\r")) + 1
        whole = bytes(self._half) + data[:end] if end else b""
        if end:
            self._half.clear()
        self._half += data[end:]
        if len(self._half) > LONGEST_LINE:
            self._bad.add(bytes(self._half[: _SHOWN + 1]), _TOO_LONG)
            self._half.clear()
            self._skipping = True
        return whole.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")[:-1]

    def _taken(self, lines: list[bytes]) -> Taken:
        if max(map(len, lines), default=0) > LONGEST_LINE:
            for line in lines:
                if len(line) > LONGEST_LINE:
                    self._bad.add(line[: _SHOWN + 1], _TOO_LONG)
            lines = [line for line in lines if len(line) <= LONGEST_LINE]
        if self._within and lines:
            self._within = False
            if self._layout is not None or not may_be_names(lines[0]):
                lines = lines[1:]
        if self._layout is None:
            lines = self._understood(lines)
        if self._layout is None:
            return Taken()
        return take(self._layout, list(filter(None, lines)), self._bad)

    def _understood(self, lines: list[bytes]) -> list[bytes]:
        """Find out how lines are written; return those that can be read then."""
        for at, line in enumerate(lines):
            if not line.strip():
                continue
            found = layout_of(self._above, line, self._options) if len(line) <= _LONGEST_FIRST else None
            if found is not None:
                self._layout, heading = found
                rest = [one for one in self._above if one not in heading] + lines[at:]
                self._above = []
                return rest
            self._above.append(line[:_LONGEST_FIRST])
            if len(self._above) > _MOST_ABOVE:
                self._give_up(self._above.pop(0))
        return []

    def _give_up(self, line: bytes) -> None:
        if not is_remark(line):
            self._bad.add(line, "no line tells what it holds")

    def _block(self, taken: Taken, came_s: float) -> Block | None:
        count = len(taken.places)
        bad, self._bad = self._bad, Bad()
        time_s = self._times(taken, count, came_s)
        self._came_s = came_s
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

    def _times(self, taken: Taken, count: int, came_s: float) -> Floats:
        stamps = np.concatenate(taken.stamps) if taken.stamps else np.empty(0)
        if len(stamps) or not count:
            return stamps
        if self._options.rate_hz is not None:
            if not self._counted:
                self._began_s = came_s
            numbers = self._counted + np.array(taken.places)
            self._counted += taken.lines
            counted: Floats = self._began_s + numbers / self._options.rate_hz
            return counted
        before_s = came_s - _SPREAD_S
        if before_s < self._came_s < came_s:
            before_s = self._came_s
        spread: Floats = before_s + (came_s - before_s) * np.arange(1, count + 1) / count
        return spread


def _loss(bad: Bad) -> Loss:
    shown = repr(bad.first[:_SHOWN].decode("utf-8", "replace")) + ("..." if len(bad.first) > _SHOWN else "")
    if bad.lines == 1:
        return Loss(LossKind.GARBLED, 1, f"A line could not be read, or not wholly: {shown}; {bad.why}.")
    lines = f"{bad.lines:,} lines could not be read, or not wholly"
    return Loss(LossKind.GARBLED, bad.lines, f"{lines}; the first is {shown}: {bad.why}.")
