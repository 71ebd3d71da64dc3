"""Write one Parquet file under a temporary name, and rename it once it is complete."""

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
from becalm.files.outputs.parquet_writer import ParquetTableWriter
from becalm.live.block import Head, Output
from becalm.live.protocols import StorageFullError
from becalm.live.tables import output_table

PART = ".part"
"""Suffix of the name of an incomplete file."""

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)  # error numbers that a full disk can cause
_MOST_ROWS, _MOST_OUTPUTS = 1 << 16, 1 << 12  # buffered before encoding; an output may be a single row


class PartFile:
    """A Parquet file that is being written; bytes that do not fit on the disk stay in memory until the next attempt.

    Parameters
    ----------
    target : Path
        Final name of the file; if it exists, NAME_02, NAME_03, ... is used.
    head : Head
        Names, units, rate and recipe of the stream.
    """

    def __init__(self, target: Path, head: Head) -> None:
        self._target, self._head = target, head
        self._path = target.with_name(f".{target.name}{PART}")
        self._packed = io.BytesIO()  # bytes that are not on the disk yet
        self._rows = ParquetTableWriter(self._packed)
        self._buffered: list[Output] = []
        self._buffered_rows = self._written = 0
        self._ended = self._made = False
        self._finished: Path | None = None  # the file, once it has its name
        self.rows = 0
        """Number of rows taken."""

    def take(self, output: Output) -> None:
        """Buffer rows in memory."""
        self._buffered.append(output)
        self._buffered_rows += len(output)
        self.rows += len(output)
        if self._buffered_rows >= _MOST_ROWS or len(self._buffered) >= _MOST_OUTPUTS:
            self._tabulate()

    def drain(self) -> None:
        """Write the encoded bytes to the disk.

        Raises
        ------
        StorageFullError
            If the disk is full; the bytes are kept for the next call.
        OutputError
            If the file cannot be written at all.
        """
        size = self._packed.tell()
        if not size:
            return
        with translate_write_errors(self._target):
            self._target.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("r+b" if self._made else "xb", buffering=0) as file:
                self._made = True
                file.seek(self._written)  # overwrite a write that a full disk cut short
                with self._packed.getbuffer() as content:
                    done = 0
                    while done < size:
                        done += file.write(content[done:])
                os.fsync(file.fileno())
        self._written += size
        self._packed.seek(0)
        self._packed.truncate()

    def finish(self) -> Path:
        """Complete the file and rename it; after an error of `drain`, it may be called again."""
        if not self._ended:
            self._tabulate()
            self._rows.close()
            self._ended = True
        self.drain()
        with translate_write_errors(self._target):
            if self._finished is None:
                target = self._free_path()
                self._path.rename(target)
                self._finished = target
            sync_folder(self._finished.parent)
        return self._finished

    def _tabulate(self) -> None:
        if self._buffered:
            self._rows.write(output_table(self._head, self._buffered))
        self._buffered, self._buffered_rows = [], 0

    def _free_path(self) -> Path:
        path = self._target
        for turn in count(2):
            if not path.exists():
                break
            path = self._target.with_stem(f"{self._target.stem}_{turn:02}")
        return path


@contextmanager
def translate_write_errors(path: Path) -> Iterator[None]:
    """Turn errors while writing a file into messages for the user.

    Raises
    ------
    StorageFullError
        If the disk is full.
    OutputError
        If the file cannot be written or locked for another reason.
    """
    try:
        yield
    except OSError as cause:
        if cause.errno in _FULL:
            raise StorageFullError(
                f"{path} cannot be written now ({cause.strerror}); free disk space, or check the disk."
            ) from cause
        raise OutputError(f"{path} cannot be written ({cause.strerror}); choose another folder.") from cause
    except sqlite3.Error as cause:  # from the lock file
        raise OutputError(f"{path} cannot be locked ({cause}); choose another folder.") from cause
