"""Collect the rows of a stream in bins: minimum and maximum over some rows, at several levels of resolution.

Bin b of level l covers rows b * rows_each[l] to (b + 1) * rows_each[l] - 1, whatever blocks the rows arrive in. One
thread writes and other threads read, without locks: a reader copies bins, and then drops the bins that the writer has
overwritten meanwhile.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.live.block import Output

LEVELS = 5  # number of levels; level 0 is the finest
COARSER = 8
"""Number of bins of a level that form one bin of the next level."""

_BINS_PER_S = 150.0  # at level 0: about 1500 in the ten seconds that a page shows
_MOST_KEPT, _LEAST_KEPT = 1 << 13, 1 << 11  # bins of each level; 8192 last 55 s, 7 min, 58 min, 8 h, 2.6 days
_MEMORY = 64 << 20  # memory limit of all levels in bytes, unless `_LEAST_KEPT` bins need more
_AT_ONCE = 1 << 8  # bins of level 0 that are written at once
_LARGEST = 1e30  # largest magnitude that a page can draw; no sensor has larger readings
_BITS = np.array([0 if verdict is Verdict.USED else 1 << verdict for verdict in Verdict], np.uint16)

Bits = np.ndarray[Any, np.dtype[np.uint16]]


class Span(NamedTuple):
    """Consecutive bins of one level, n in number; unknown values are NaN."""

    first: int
    """Number of the first bin."""

    time_s: Floats
    """(n,) stamp of the first row of each bin, in seconds."""

    low: Floats
    """(n, 2m) minima of the m channels' raw readings, then minima of their clean values."""

    high: Floats
    """(n, 3m + K) maxima of readings and of clean values, of sigma, and of the probabilities of K modes."""

    verdicts: Bits
    """(n, m) the bit 1 << v is set if the verdict v occurs; USED has no bit."""

    def __len__(self) -> int:
        """Return the number of bins."""
        return len(self.time_s)

    def part(self, begin: int, end: int) -> Span:
        """Return the bins with indices `begin` to `end` - 1."""
        some = slice(begin, end)
        return Span(self.first + begin, self.time_s[some], self.low[some], self.high[some], self.verdicts[some])


class Bins:
    """The newest bins of a stream at each level, within a memory limit.

    A bin takes 8 bytes, 42 bytes more for each channel and 8 more for each mode: six channels without modes take 10 MB,
    and up to 150 channels at most 64 MB.

    Parameters
    ----------
    channels : int
        Number of channels, m.
    rate_hz : float
        Nominal number of rows per second.
    modes : int
        Number of modes of all channels together, K.
    """

    def __init__(self, channels: int, rate_hz: float, modes: int = 0) -> None:
        self._channels, self._modes = channels, modes
        finest = max(1, round(rate_hz / _BINS_PER_S))
        self.rows_each = tuple(finest * COARSER**level for level in range(LEVELS))
        each = LEVELS * (channels * (5 * 8 + 2) + modes * 8 + 8)
        self.kept = max(_LEAST_KEPT, min(_MOST_KEPT, _MEMORY // each))
        """Number of bins that each level keeps, which are the newest ones."""
        self._rings = [_Ring(self.kept, channels, modes) for _ in self.rows_each]
        self._open: Span | None = None  # the bin whose last rows are still missing

    def push(self, output: Output) -> None:
        """Add the next rows; the first row of a resumed stream may have any number."""
        rows = self.rows_each[0] * _AT_ONCE
        for begin in range(0, len(output), rows):
            self._push(output, slice(begin, begin + rows))

    def finish(self) -> None:
        """Close the last, incomplete bins at the end of the stream."""
        if self._open is not None:
            self._rings[0].write(self._open)
            self._open = None
        for lower, upper in pairwise(self._rings):
            self._coarsen(lower, upper, -(-lower.closed // COARSER))

    def newest(self, level: int) -> int:
        """Return the number of the bin after the last closed bin."""
        return self._rings[level].closed

    def oldest(self, level: int) -> int:
        """Return the number of the oldest bin that can be read."""
        ring = self._rings[level]
        return max(ring.began, ring.closed - self.kept)

    def read(self, level: int, first: int, stop: int) -> Span:
        """Return the closed bins with numbers `first` to `stop` - 1 that are still kept."""
        ring = self._rings[level]
        stop = min(stop, ring.closed)
        first = min(max(first, self.oldest(level)), stop)
        span = ring.read(first, stop)
        overtaken = max(0, min(ring.claimed - self.kept - first, len(span)))
        return span.part(overtaken, len(span)) if overtaken else span

    def _push(self, output: Output, some: slice) -> None:
        columns = self._columns(output, some)
        row, each = output.first_row + (some.start or 0), self.rows_each[0]
        codes = output.verdicts[some]
        bits = _BITS[codes] if codes.any() else np.zeros(codes.shape, np.uint16)
        low = columns[:, : 2 * self._channels]
        span = _coarser(Span(row, output.time_s[some], low, columns, bits), each)
        if self._open is not None and self._open.first == span.first:
            span = _merge_first(self._open, span)
        whole = (row + len(columns)) % each == 0
        self._open = None if whole else span.part(len(span) - 1, len(span))
        self._rings[0].write(span if whole else span.part(0, len(span) - 1))
        for lower, upper in pairwise(self._rings):
            if not self._coarsen(lower, upper, lower.closed // COARSER):
                break

    def _columns(self, output: Output, some: slice) -> Floats:
        """Return columns: readings, clean values, sigma, probabilities; values that cannot be drawn are NaN."""
        fields = [output.values[some], output.signal[some], output.sigma[some]]
        if self._modes:
            has_modes = output.modes.shape == (len(output), self._modes)
            fields.append(output.modes[some] if has_modes else np.full((len(fields[0]), self._modes), np.nan))
        columns = np.concatenate(fields, axis=1)
        columns += 0.0  # turns -0 into 0: the minimum of the two zeros would depend on their order
        small = np.abs(columns) <= _LARGEST
        if not small.all():
            columns[~small] = np.nan
        return columns

    def _coarsen(self, lower: _Ring, upper: _Ring, closed: int) -> bool:
        """Close the bins of the upper level with numbers below `closed`; return whether any was open."""
        first = upper.closed * COARSER if upper.closed else lower.began
        if closed * COARSER <= first:
            return False
        upper.write(_coarser(lower.read(first, min(closed * COARSER, lower.closed)), COARSER))
        return True


class _Ring:
    """A ring buffer of the newest bins of one level."""

    def __init__(self, kept: int, channels: int, modes: int) -> None:
        self._kept = kept
        self._time_s, self._verdicts = np.zeros(kept), np.zeros((kept, channels), np.uint16)
        self._low, self._high = np.zeros((kept, 2 * channels)), np.zeros((kept, 3 * channels + modes))
        self.began = 0  # number of the first bin of the stream
        self.closed = 0  # number after the last complete bin
        self.claimed = 0  # number after the last bin that is complete or being written

    def write(self, span: Span) -> None:
        """Append bins."""
        if not len(span):
            return
        if self.closed == self.began:
            self.began = self.closed = span.first
        stop = self.claimed = span.first + len(span)
        at = np.arange(span.first, stop) % self._kept
        self._time_s[at], self._low[at], self._high[at] = span.time_s, span.low, span.high
        self._verdicts[at] = span.verdicts
        self.closed = stop

    def read(self, first: int, stop: int) -> Span:
        """Copy some bins."""
        at = np.arange(first, stop) % self._kept
        return Span(first, self._time_s[at], self._low[at], self._high[at], self._verdicts[at])


def _coarser(span: Span, each: int) -> Span:
    """Merge each `each` rows or smaller bins into one bin; the first and the last bin may have fewer."""
    first, stop = span.first // each, span.first + len(span)
    starts = np.arange(first * each, stop, each) - span.first
    starts[0] = 0
    return Span(
        first,
        span.time_s[starts],
        np.fmin.reduceat(span.low, starts, axis=0),
        np.fmax.reduceat(span.high, starts, axis=0),
        np.bitwise_or.reduceat(span.verdicts, starts, axis=0),
    )


def _merge_first(incomplete: Span, span: Span) -> Span:
    """Merge an incomplete bin into the first bin of a span, which continues it; return the span."""
    span.time_s[0] = incomplete.time_s[0]
    span.low[0] = np.fmin(incomplete.low[0], span.low[0])
    span.high[0] = np.fmax(incomplete.high[0], span.high[0])
    span.verdicts[0] |= incomplete.verdicts[0]
    return span
