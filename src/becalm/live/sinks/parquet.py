"""parquet: the hours of a stream as files that are whole."""

from __future__ import annotations

import logging
import sqlite3
from dataclasses import replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from threading import Lock

import numpy as np

from becalm.errors import UsageError
from becalm.live.address import Address
from becalm.live.block import Head, Output
from becalm.live.locking import locked
from becalm.live.sinks.parquet_part import PART, PartFile, told
from becalm.live.tables import EPOCH_S, table_schema

_HOUR_S = 3600.0
_LATEST_S = 1e11  # the year 5138: what is later counts something else
_LOCK = ".becalm.lock"
_log = logging.getLogger(__name__)


class ParquetSink:
    """Writes DIR/YYYY-MM-DD/HH.parquet (UTC) as hours close; where stamps do not count from 1970, DIR/rows-N.parquet.

    N is the first row. A file has a temporary name until it is whole. What was not whole when a process was killed is
    lost here, and is kept aside as *.part-left-1 when the sink is opened again; the journal is what keeps. A name
    that is taken becomes HH_02.parquet, and so on: nothing is written over. One process writes to a folder.

    The columns are `row`, `time_s` and of each channel NAME, NAME_raw, NAME_sigma and NAME_verdict, in words; units
    are in the columns' metadata, the recipe in that of the file.

    Parameters
    ----------
    address : Address
        `parquet:DIR`; `rows=N` closes a file after N rows. Without it that is an hour at the nominal rate, and where
        stamps count from 1970, and go back, two.

    Raises
    ------
    UsageError
        If the address has no folder, or other options.
    """

    def __init__(self, address: Address) -> None:
        address.refuse_unknown(("rows",))
        if not address.rest:
            raise UsageError("parquet: needs a folder; write parquet:DIR.")
        self._folder = Path(address.rest)
        self._asked = int(address.number("rows", 0, least=1)) if "rows" in address.options else None
        self._lock, self._taken = Lock(), list[Output]()
        self._lock_file: sqlite3.Connection | None = None
        self._part: PartFile | None = None
        self._over: list[PartFile] = []  # to be made whole

    def open(self, head: Head) -> None:
        """Make the folder, and put aside what a killed process left there.

        Raises
        ------
        BecalmError
            If the folder cannot be written to, another process does, or channels' names do not go together.
        """
        self.close()
        table_schema(head)
        self._head = head
        with told(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
            self._lock_file = locked(
                self._folder / _LOCK, f"Another process writes to {self._folder}; name another folder."
            )
            for left in sorted(self._folder.rglob(f".*{PART}")):
                aside = _aside(left)
                left.rename(aside)
                _log.warning(
                    "%s was not whole when its writer ended; its rows are lost here. It is %s now.", left, aside
                )

    def write(self, output: Output) -> None:
        """Take some rows into memory; `flush`, which another thread may call, has the work with them."""
        if len(output):
            with self._lock:
                self._taken.append(output)

    def flush(self) -> None:
        """Write what can be written, and make the files whole whose hours have closed.

        Raises
        ------
        StorageFullError
            If there is no room; nothing is lost, and it may be tried again.
        OutputError
            If files cannot be written at all.
        """
        self._place()
        while self._over:
            self._over[0].finish()
            del self._over[0]
        if self._part is not None:
            self._part.drain()

    def close(self) -> None:
        """Make the last file whole, or raise as `flush`; harmless twice."""
        self._place()
        if self._part is not None:
            self._over.append(self._part)
            self._part = None
        self.flush()
        if self._lock_file is not None:
            self._lock_file.close()
            self._lock_file = None

    def _place(self) -> None:
        """Put each row into the file of its hour, in memory."""
        with self._lock:
            taken, self._taken = self._taken, []
        for output in taken:
            start = 0
            while start < len(output):
                part = self._part = self._part or self._begun(output, start)
                end = self._end(part, output, start)
                if end > start:
                    part.take(_some(output, start, end))
                if end < len(output) or part.rows >= self._most:
                    self._over.append(part)
                    self._part = None
                start = end

    def _begun(self, output: Output, start: int) -> PartFile:
        """Begin the file of the hour, or of the number, of a row."""
        stamp, hour_rows = float(output.time_s[start]), max(int(self._head.rate_hz * _HOUR_S), 1)
        if EPOCH_S <= stamp < _LATEST_S:
            hour = datetime.fromtimestamp(stamp // _HOUR_S * _HOUR_S, UTC)
            self._until_s = hour.timestamp() + _HOUR_S
            self._most = self._asked or 2 * hour_rows
            return PartFile(self._folder / f"{hour:%Y-%m-%d}" / f"{hour:%H}.parquet", self._head)
        self._until_s, self._most = np.inf, self._asked or hour_rows
        return PartFile(self._folder / f"rows-{output.first_row + start:012}.parquet", self._head)

    def _end(self, part: PartFile, output: Output, start: int) -> int:
        """Return the row of an output, from `start`, before which a file ends."""
        stamps = output.time_s[start : start + self._most - part.rows]
        later = (stamps >= self._until_s) & (stamps < _LATEST_S)
        return start + (int(later.argmax()) if later.any() else len(stamps))


def _some(output: Output, start: int, end: int) -> Output:
    if start == 0 and end == len(output):
        return output
    parts = ("time_s", "values", "signal", "sigma", "verdicts")
    return replace(
        output, first_row=output.first_row + start, **{name: getattr(output, name)[start:end] for name in parts}
    )


def _aside(left: Path) -> Path:
    """Return a name, free yet, that no reader takes for a file that is whole."""
    return next(path for turn in count(1) if not (path := left.with_name(f"{left.name}-left-{turn}")).exists())
