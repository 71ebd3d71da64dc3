"""One Parquet file while it is written: under a temporary name, and whole before it gets its own."""

from __future__ import annotations

import errno
import io
import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from becalm.errors import OutputError
from becalm.files.atomic_file import sync_folder
from becalm.files.parquet_writer import ParquetTableWriter
from becalm.live.block import Head, Output
from becalm.live.protocols import StorageFullError
from becalm.live.tables import output_table

PART = ".part"
"""Ends the name of a file that is not whole yet."""

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)
_MOST_ROWS, _MOST_OUTPUTS = 1 << 16, 1 << 12  # held until they are made a table: an output may be a single row


class PartFile:
    """Takes outputs; what does not fit on the disk waits here, so that each step may be tried again.

    Parameters
    ----------
    target : Path
        The file's own name; where that is taken it becomes NAME_02, NAME_03, ...
    head : Head
        What all rows share.
    """

    def __init__(self, target: Path, head: Head) -> None:
        self._target, self._head = target, head
        self._path = target.with_name(f".{target.name}{PART}")
        self._packed = io.BytesIO()  # what is not on the disk yet
        self._rows = ParquetTableWriter(self._packed)
        self._held: list[Output] = []
        self._held_rows = self._written = 0
        self._ended = self._made = False
        self.rows = 0

    def take(self, output: Output) -> None:
        """Take some rows into memory."""
        self._held.append(output)
        self._held_rows += len(output)
        self.rows += len(output)
        if self._held_rows >= _MOST_ROWS or len(self._held) >= _MOST_OUTPUTS:
            self._tabulate()

    def drain(self) -> None:
        """Write what is packed.

        Raises
        ------
        StorageFullError
            If there is no room; it waits for the next call.
        OutputError
            If it cannot be written at all.
        """
        size = self._packed.tell()
        if not size:
            return
        with told(self._target):
            self._target.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("r+b" if self._made else "xb", buffering=0) as file:
                self._made = True
                file.seek(self._written)  # what a full disk cut short is written over
                with self._packed.getbuffer() as waiting:
                    done = 0
                    while done < size:
                        done += file.write(waiting[done:])
                os.fsync(file.fileno())
        self._written += size
        self._packed.seek(0)
        self._packed.truncate()

    def finish(self) -> Path:
        """Make the file whole, and give it its own name; or raise as `drain`, and it may be tried again."""
        if not self._ended:
            self._tabulate()
            self._rows.close()
            self._ended = True
        self.drain()
        with told(self._target):
            target = self._free()
            self._path.rename(target)
            sync_folder(target.parent)
        return target

    def _tabulate(self) -> None:
        if self._held:
            self._rows.write(output_table(self._head, self._held))
        self._held, self._held_rows = [], 0

    def _free(self) -> Path:
        path = self._target
        for turn in count(2):
            if not path.exists():
                break
            path = self._target.with_stem(f"{self._target.stem}_{turn:02}")
        return path


@contextmanager
def told(path: Path) -> Iterator[None]:
    """Say in a sentence why a file cannot be written."""
    try:
        yield
    except OSError as cause:
        if cause.errno in _FULL:
            raise StorageFullError(f"There is no room for {path} ({cause.strerror}); make room.") from cause
        raise OutputError(f"{path} cannot be written ({cause.strerror}); choose another folder.") from cause
    except sqlite3.Error as cause:  # of the lock beside it
        raise OutputError(f"{path} cannot be locked ({cause}); choose another folder.") from cause
