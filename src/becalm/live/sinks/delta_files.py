"""The files of a Delta table, in a folder or behind a URI; those in a folder last through a power cut."""

from __future__ import annotations

import io
import json
import logging
import os
import sqlite3
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import fs

from becalm.files.atomic_file import sync_folder
from becalm.files.parquet_writer import ParquetTableWriter
from becalm.live.locking import locked
from becalm.live.optional_libraries import wanted

BESIDE = "_becalm"
"""Where checkpoints are; readers and cleaners of Delta tables pass by names that begin with an underscore."""

_LOG = "_delta_log"
_told = logging.getLogger(__name__)


class DeltaFiles:
    """Writes, reads and removes files of one table.

    Parameters
    ----------
    place : str
        A folder, or a URI.
    """

    def __init__(self, place: str) -> None:
        self.folder = None if "://" in place else Path(place)
        self._place = place
        self._lock: sqlite3.Connection | None = None

    def put_table(self, name: str, table: pa.Table) -> int:
        """Write a Parquet file that lasts, and return its size in bytes."""
        packed = io.BytesIO()
        rows = ParquetTableWriter(packed)
        rows.write(table)
        rows.close()
        self._put(name, packed.getvalue())
        return packed.tell()

    def put(self, name: str, content: bytes) -> None:
        """Write some bytes beside the table, to last."""
        self._fs.create_dir(BESIDE)
        self._put(f"{BESIDE}/{name}", content)

    def get(self, name: str) -> bytes:
        """Return what was put beside the table."""
        with self._fs.open_input_stream(f"{BESIDE}/{name}") as file:
            return bytes(file.read())

    def remove(self, name: str) -> None:
        """Remove a file, if it is there and lets itself be removed."""
        with suppress(OSError):
            self._fs.delete_file(name)

    def beside(self) -> list[str]:
        """Return the names of what was put beside the table."""
        found = self._fs.get_file_info(fs.FileSelector(BESIDE, allow_not_found=True))
        return [one.base_name for one in found if one.base_name.endswith(".json")]

    def lock(self, refusal: str) -> None:
        """Keep other processes from a table in a folder; behind a URI the second one's commit fails.

        Raises
        ------
        UsageError
            If another one has it.
        """
        if self.folder is not None and self._lock is None:
            (self.folder / BESIDE).mkdir(exist_ok=True)
            self._lock = locked(self.folder / BESIDE / "lock", refusal)

    def unlock(self) -> None:
        """Let others write; harmless twice."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def commit_lasts(self, version: int) -> None:
        """Make a commit last through a power cut: deltalake itself leaves it to the system when to write it."""
        self._last(f"{_LOG}/{version:020}.json")

    def set_torn_commit_aside(self) -> None:
        """Rename a last commit that a power cut tore; whoever made it never heard that it was kept."""
        if self.folder is None:
            return
        commits = sorted((self.folder / _LOG).glob("*.json"))
        if commits and not _whole(commits[-1]):
            commits[-1].rename(commits[-1].with_suffix(".json.torn"))
            _told.warning(
                "The last commit in %s was torn, and is kept aside as %s.torn.", self.folder, commits[-1].name
            )

    def _put(self, name: str, content: bytes) -> None:
        with self._fs.open_output_stream(name) as file:
            file.write(content)
        self._last(name)

    @cached_property
    def _fs(self) -> fs.FileSystem:
        """The files as pyarrow sees them; made late, as a store may refuse what is not there yet."""
        if self.folder is None:
            return fs.PyFileSystem(_store(self._place))
        return fs.SubTreeFileSystem(str(self.folder.resolve()), fs.LocalFileSystem())

    def _last(self, name: str) -> None:
        """Have a file and its name on the disk, where it is one; behind a URI it is when it is closed."""
        if self.folder is None:
            return
        file, top = self.folder / name, self.folder.parent
        with file.open("r+b") as made:
            os.fsync(made.fileno())
        for folder in file.parents:
            if folder.is_relative_to(top):
                sync_folder(folder)


def library(part: str = "") -> Any:
    """Return the module deltalake, or one of its parts.

    Raises
    ------
    UsageError
        If it is not installed.
    """
    return wanted("delta:", f"deltalake.{part}" if part else "deltalake", "deltalake", "delta")


class _PlainBytes:
    """A file that is given plain bytes only, as deltalake's must be; pyarrow hands buffers of its own to files."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def write(self, content: Any) -> None:
        self._file.write(bytes(content))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def _store(place: str) -> Any:
    """Return the files behind a URI, by deltalake's own way to it."""
    handler = library("fs").DeltaStorageHandler

    class Store(handler):  # type: ignore[misc, valid-type]
        def open_output_stream(self, path: str, metadata: Any = None) -> pa.PythonFile:
            return pa.PythonFile(_PlainBytes(self._handler.open_output_stream(path, metadata)))

    return Store(place)


def _whole(commit: Path) -> bool:
    try:
        return bool([json.loads(line) for line in commit.read_bytes().splitlines()])
    except ValueError:
        return False
