"""Read any rows of a source that another process has opened, with the clock of the whole recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.core.time.clock import Clock
from becalm.files.atomic_file import explain_write_errors
from becalm.files.inputs.opening import Chunk, OpenSource
from becalm.files.rows import rebatched
from becalm.files.source import RawTable

_AT_ONCE = 1 << 20  # stamps that are written at a time


class ParsedSource(NamedTuple):
    """The result of opening a source, in a form that can be sent to another process."""

    names: tuple[str, ...]  # the channels
    clock: Clock
    rows: int
    stamps: str  # path of the file with the time of each row in seconds, as float64; "" for an even clock


def parse_source(source: OpenSource, stamps: Path) -> ParsedSource:
    """Return a source's channels, clock and number of rows; if its time is uneven, write its stamps to a file.

    Parameters
    ----------
    source : OpenSource
        The source; it stays open.
    stamps : Path
        The file for the stamps; all processes that read the source must have access to it.

    Raises
    ------
    OutputError
        If the stamps cannot be written.
    """
    if source.clock.even:
        return ParsedSource(source.names, source.clock, source.rows, "")
    with explain_write_errors(stamps), stamps.open("wb") as file:
        for first in range(0, source.rows, _AT_ONCE):
            file.write(source.seconds(first, min(_AT_ONCE, source.rows - first)).tobytes())
    return ParsedSource(source.names, source.clock, source.rows, str(stamps))


class SharedSource:
    """A source whose channels and clock another process has determined.

    Parameters
    ----------
    raw : RawTable
        Its columns.
    parsed : ParsedSource
        Its channels, clock and number of rows.

    Attributes
    ----------
    schema : pyarrow.Schema
        The schema of the tables of its chunks.
    clock : Clock
        Step, gaps and jitter of its time.
    """

    def __init__(self, raw: RawTable, parsed: ParsedSource) -> None:
        self._raw, self._parsed = raw, parsed
        self.schema: pa.Schema = raw.rows.schema
        self.clock = parsed.clock

    def chunks(self, first: int, stop: int, rows: int) -> Iterator[Chunk]:
        """Yield the rows from `first` up to `stop` in chunks of `rows` rows.

        Raises
        ------
        InputError
            If the file is damaged, or changes while it is read.
        """
        row = first
        for table in rebatched(self._blocks_until(first, stop, rows), rows):
            yield Chunk(row, table, self.elapsed(row, table.num_rows), self._parsed.names, self._raw.decimal)
            row += table.num_rows
        if self._raw.original is not None:
            self._raw.original.refuse_changed()

    def elapsed(self, first: int, count: int) -> Floats:
        """Return the time since the previous row in steps, (count,), for each row from `first` on."""
        if not self._parsed.stamps:
            return self.clock.elapsed_rows(first, count)
        begin = max(0, first - 1)
        stamps = np.fromfile(self._parsed.stamps, np.float64, first + count - begin, offset=8 * begin)
        return self.clock.elapsed(stamps[first - begin :], float(stamps[0]) if first else None)

    def steps_before(self, row: int) -> float:
        """Return the time from the first row to the row before `row`, in steps."""
        if not self._parsed.stamps or row < 1:
            return float(max(0, row - 1))
        ends = [np.fromfile(self._parsed.stamps, np.float64, 1, offset=8 * at)[0] for at in (0, row - 1)]
        steps = float(ends[1] - ends[0]) / self.clock.near_s
        return float(round(steps)) if self.clock.uniform else steps

    def close(self) -> None:
        """Close the file."""
        self._raw.rows.close()

    def _blocks_until(self, first: int, stop: int, rows: int) -> Iterator[pa.Table]:
        left = stop - first
        for block in self._raw.blocks(self._raw.names, first, most_rows=rows):
            yield block.slice(0, left)
            left -= block.num_rows
            if left <= 0:
                return
