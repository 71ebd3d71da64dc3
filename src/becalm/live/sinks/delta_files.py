"""Write and read the files of a Delta table in a folder or a remote store; files in a folder are synced."""

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
from becalm.files.outputs.parquet_writer import ParquetTableWriter
from becalm.live.locking import lock_file
from becalm.live.optional_libraries import import_optional

CHECKPOINT_FOLDER = "_becalm"
"""Folder of the checkpoints; programs that read or clean Delta tables ignore names with a leading underscore."""

_LOG_FOLDER = "_delta_log"
_log = logging.getLogger(__name__)


class DeltaFiles:
    """The files of one table.

    Parameters
    ----------
    place : str
        Folder or URI of the table.
    """

    def __init__(self, place: str) -> None:
        self.folder = None if "://" in place else Path(place)
        self._place = place
        self._lock: sqlite3.Connection | None = None

    def put_table(self, name: str, table: pa.Table) -> int:
        """Write a Parquet file and sync it; return its size in bytes."""
        packed = io.BytesIO()
        rows = ParquetTableWriter(packed)
        rows.write(table)
        rows.close()
        self._put(name, packed.getvalue())
        return packed.tell()

    def put(self, name: str, content: bytes) -> None:
        """Write a file to the checkpoint folder and sync it."""
        self._fs.create_dir(CHECKPOINT_FOLDER)
        self._put(f"{CHECKPOINT_FOLDER}/{name}", content)

    def get(self, name: str) -> bytes:
        """Return the content of a file in the checkpoint folder."""
        with self._fs.open_input_stream(f"{CHECKPOINT_FOLDER}/{name}") as file:
            return bytes(file.read())

    def remove(self, name: str) -> None:
        """Remove a file; ignore errors."""
        with suppress(OSError):
            self._fs.delete_file(name)

    def checkpoint_names(self) -> list[str]:
        """Return the names of the files in the checkpoint folder."""
        files = self._fs.get_file_info(fs.FileSelector(CHECKPOINT_FOLDER, allow_not_found=True))
        return [one.base_name for one in files if one.base_name.endswith(".json")]

    def lock(self, refusal: str) -> None:
        """Lock a table in a folder against other writers; in a remote store a second writer's commit fails instead.

        Raises
        ------
        UsageError
            If another process writes to the table; `refusal` is the message.
        """
        if self.folder is not None and self._lock is None:
            (self.folder / CHECKPOINT_FOLDER).mkdir(exist_ok=True)
            self._lock = lock_file(self.folder / CHECKPOINT_FOLDER / "lock", refusal)

    def unlock(self) -> None:
        """Release the lock; may be called twice."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def sync_commit(self, version: int) -> None:
        """Sync a commit to the disk, which deltalake does not do, so that a power cut does not lose it."""
        self._sync(f"{_LOG_FOLDER}/{version:020}.json")

    def set_torn_commit_aside(self) -> None:
        """Rename the last commit if a power cut left it incomplete; it was never reported as committed."""
        if self.folder is None:
            return
        commits = sorted((self.folder / _LOG_FOLDER).glob("*.json"))
        if commits and not _is_complete(commits[-1]):
            commits[-1].replace(commits[-1].with_suffix(".json.torn"))
            _log.warning("The last commit in %s was torn; it was renamed to %s.torn.", self.folder, commits[-1].name)

    def _put(self, name: str, content: bytes) -> None:
        with self._fs.open_output_stream(name) as file:
            file.write(content)
        self._sync(name)

    @cached_property
    def _fs(self) -> fs.FileSystem:
        """Return the table's file system; it is made on first use, because a store may refuse a missing table."""
        if self.folder is None:
            return fs.PyFileSystem(_store(self._place))
        return fs.SubTreeFileSystem(str(self.folder.resolve()), fs.LocalFileSystem())

    def _sync(self, name: str) -> None:
        """Sync a local file and its folders to the disk; a remote file is stored once it is closed."""
        if self.folder is None:
            return
        file, top = self.folder / name, self.folder.parent
        with file.open("r+b") as opened:
            os.fsync(opened.fileno())
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
    return import_optional("delta:", f"deltalake.{part}" if part else "deltalake", "deltalake", "delta")


class _PlainBytes:
    """A file wrapper that converts pyarrow's buffers to bytes, which deltalake's files require."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def write(self, content: Any) -> None:
        self._file.write(bytes(content))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def _store(place: str) -> Any:
    """Return deltalake's file system for a URI, as a handler for pyarrow."""
    handler = library("fs").DeltaStorageHandler

    class Store(handler):  # type: ignore[misc, valid-type]
        def open_output_stream(self, path: str, metadata: Any = None) -> pa.PythonFile:
            return pa.PythonFile(_PlainBytes(self._handler.open_output_stream(path, metadata)))

    return Store(place)


def _is_complete(commit: Path) -> bool:
    try:
        return bool([json.loads(line) for line in commit.read_bytes().splitlines()])
    except ValueError:
        return False
