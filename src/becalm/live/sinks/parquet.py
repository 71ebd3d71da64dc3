"""The sink parquet: write a stream to one Parquet file per hour."""

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
from becalm.live.locking import lock_file
from becalm.live.sinks.parquet_part import PART, PartFile, translate_write_errors
from becalm.live.tables import EPOCH_S, table_schema

_HOUR_S = 3600.0
_LATEST_S = 1e11  # the year 5138; a later stamp is not a date
_LOCK = ".becalm.lock"
_log = logging.getLogger(__name__)


class ParquetSink:
    """A sink that writes DIR/YYYY-MM-DD/HH.parquet (UTC), or DIR/rows-N.parquet if stamps do not count from 1970.

    N is the number of the first row. A file has a temporary name until it is complete. If the process is killed, the
    rows of an incomplete file are lost in this sink, and the file is renamed to *.part-left-1 when the sink is opened
    again; the journal loses no rows. If a name exists, the next file is HH_02.parquet, and so on: nothing is
    overwritten. Only one process may write to a folder.

    The columns are `row`, `time_s` and for each channel NAME, NAME_raw, NAME_sigma and NAME_verdict (words); units
    are in the metadata of the columns, and the recipe is in the file's metadata.

    Parameters
    ----------
    address : Address
        `parquet:DIR`; `rows=N` closes a file after N rows. The default is the number of rows in an hour at the
        nominal rate, or in two hours if stamps count from 1970, because such stamps may go back.

    Raises
    ------
    UsageError
        If the address has no folder, or unknown options.
    """

    def __init__(self, address: Address) -> None:
        address.refuse_unknown(("rows",))
        if not address.rest:
            raise UsageError("parquet: needs a folder; write parquet:DIR.")
        self._folder = Path(address.rest)
        self._rows_option = int(address.number("rows", 0, least=1)) if "rows" in address.options else None
        self._lock, self._buffered = Lock(), list[Output]()
        self._lock_file: sqlite3.Connection | None = None
        self._part: PartFile | None = None
        self._complete: list[PartFile] = []  # parts with all their rows, to be finished on disk

    def open(self, head: Head) -> None:
        """Create the folder, and rename incomplete files that a killed process left there.

        Raises
        ------
        BecalmError
            If the folder cannot be written, another process writes to it, or the names of two columns are the same.
        """
        self.close()
        table_schema(head)
        self._head = head
        with translate_write_errors(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
            self._lock_file = lock_file(
                self._folder / _LOCK, f"Another process writes to {self._folder}; choose another folder."
            )
            for left in sorted(self._folder.rglob(f".*{PART}")):
                renamed = _free_name(left)
                left.rename(renamed)
                _log.warning(
                    "%s was incomplete when its writer ended; its rows are lost here. It was renamed to %s.",
                    left,
                    renamed,
                )

    def write(self, output: Output) -> None:
        """Buffer rows in memory; `flush`, which another thread may call, writes them."""
        if len(output):
            with self._lock:
                self._buffered.append(output)

    def flush(self) -> None:
        """Write the buffered rows, and finish the files of completed hours.

        Raises
        ------
        StorageFullError
            If the disk is full; nothing is lost, and the call may be repeated.
        OutputError
            If the files cannot be written at all.
        """
        self._distribute()
        while self._complete:
            self._complete[0].finish()
            del self._complete[0]
        if self._part is not None:
            self._part.drain()

    def close(self) -> None:
        """Finish the last file; raises the errors of `flush`. May be called twice."""
        self._distribute()
        if self._part is not None:
            self._complete.append(self._part)
            self._part = None
        self.flush()
        if self._lock_file is not None:
            self._lock_file.close()
            self._lock_file = None

    def _distribute(self) -> None:
        """Add each buffered row to the file of its hour, in memory."""
        with self._lock:
            taken, self._buffered = self._buffered, []
        for output in taken:
            start = 0
            while start < len(output):
                part = self._part = self._part or self._new_part(output, start)
                end = self._end(part, output, start)
                if end > start:
                    part.take(_rows(output, start, end))
                if end < len(output) or part.rows >= self._most_rows:
                    self._complete.append(part)
                    self._part = None
                start = end

    def _new_part(self, output: Output, start: int) -> PartFile:
        """Return a new file, named after the hour or the number of row `start` of an output."""
        stamp, hour_rows = float(output.time_s[start]), max(int(self._head.rate_hz * _HOUR_S), 1)
        if EPOCH_S <= stamp < _LATEST_S:
            hour = datetime.fromtimestamp(stamp // _HOUR_S * _HOUR_S, UTC)
            self._until_s = hour.timestamp() + _HOUR_S
            self._most_rows = self._rows_option or 2 * hour_rows
            return PartFile(self._folder / f"{hour:%Y-%m-%d}" / f"{hour:%H}.parquet", self._head)
        self._until_s, self._most_rows = np.inf, self._rows_option or hour_rows
        return PartFile(self._folder / f"rows-{output.first_row + start:012}.parquet", self._head)

    def _end(self, part: PartFile, output: Output, start: int) -> int:
        """Return the index in an output of the first row from `start` on that belongs to the next file."""
        stamps = output.time_s[start : start + self._most_rows - part.rows]
        later = (stamps >= self._until_s) & (stamps < _LATEST_S)
        return start + (int(later.argmax()) if later.any() else len(stamps))


def _rows(output: Output, start: int, end: int) -> Output:
    if start == 0 and end == len(output):
        return output
    parts = ("time_s", "values", "signal", "sigma", "verdicts")
    return replace(
        output, first_row=output.first_row + start, **{name: getattr(output, name)[start:end] for name in parts}
    )


def _free_name(left: Path) -> Path:
    """Return an unused name that readers do not take for a complete file."""
    return next(path for turn in count(1) if not (path := left.with_name(f"{left.name}-left-{turn}")).exists())
