"""Tables to MF4, version 4.10: a channel group for each table, its rows kept in a temporary file until the end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import IO, Any
from xml.sax.saxutils import escape, quoteattr

import pyarrow as pa

from becalm.errors import OutputError
from becalm.files.arrays.array_labels import OF_TABLE
from becalm.files.column_arrays import refuse_strange_types, told_of
from becalm.files.groups import GROUP, START
from becalm.files.recorders.mf4_tables import MdfTable
from becalm.files.temporary_files import in_waiting
from becalm.installation import version

_UTC, _LOCAL = 2, 1  # flags of a header's time


class Mf4Rows:
    """Writes tables of one schema below each other; those of another group go into a channel group of their own.

    The master of a group is its first column of times in numbers, in s; without one it counts rows. Words that repeat
    are codes, with a conversion from value to text. Missing whole numbers and flags are invalid samples. What is told
    of the file stands in its history (##FH), and the first instant is its start.

    Parameters
    ----------
    file : binary file
        Where to; what is not yet in it waits in its folder.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._stack = ExitStack()
        self._library = _asammdf()
        self._log: Any = None
        self._tables: dict[str, MdfTable] = {}
        self._told: dict[str, str] = {}

    def write(self, table: pa.Table) -> None:
        """Write some rows of a group."""
        told = told_of(table.schema)
        group = told.get(GROUP, "")
        if group not in self._tables:
            refuse_strange_types(table.schema, "MF4")
            self._told |= {key: text for key, text in told.items() if key not in OF_TABLE}
            self._tables[group] = MdfTable(self._library, group, told.get(START, ""))
        if self._log is None:
            self._log = self._begun()
        with _sentence(self._library):
            self._tables[group].write(self._log, table)

    def close(self) -> None:
        """Write all; the file stays open."""
        if self._log is None:
            return
        self._tell_start()
        history = self._library.blocks.v4_blocks.FileHistory()
        # the hour of writing is left out: the same recipe gives the same bytes
        history.abs_time, history.tz_offset, history.daylight_save_time, history.time_flags = 0, 0, 0, _UTC
        history.comment = _comment(self._told)
        self._log.file_history.append(history)
        with _sentence(self._library):
            for table in self._tables.values():
                table.close(self._log)
            self._log.save(self._file, add_history_block=False)
        self.drop()

    def drop(self) -> None:
        """Let go of what waits."""
        self._log = None
        with suppress(Exception):  # it is unwanted by now, and may be half written
            self._stack.close()

    def _begun(self) -> Any:
        """Return an empty log, whose rows wait beside the output, where there is the room for them."""
        folder = None
        if isinstance(getattr(self._file, "name", None), str):
            folder = Path(f"{self._file.name}.rows")
            self._stack.enter_context(in_waiting(folder))
            folder.mkdir()
        log = self._library.MDF(version="4.10", temporary_folder=folder)
        self._stack.callback(log.close)
        return log

    def _tell_start(self) -> None:
        """Set the first instant of the file, and when each group begins after it."""
        header = self._log.header
        header.abs_time, header.tz_offset, header.daylight_save_time, header.time_flags = 0, 0, 0, _UTC
        begun = [table for table in self._tables.values() if table.zero_ns is not None]
        zoned = bool(begun) and begun[0].start.endswith("Z")
        alike = [table for table in begun if table.start.endswith("Z") == zoned]
        if alike:
            header.abs_time = min(table.zero_ns or 0 for table in alike)
            header.time_flags = _UTC if zoned else _LOCAL
            for table in self._tables.values():
                table.after_ns = (table.zero_ns or 0) - header.abs_time if table in alike else None


def _comment(told: Mapping[str, str]) -> str:
    entries = "".join(f"<e name={quoteattr(key)}>{escape(text)}</e>" for key, text in told.items())
    return (
        "<FHcomment><TX>Written by becalm</TX><tool_id>becalm</tool_id><tool_vendor>becalm</tool_vendor>"
        f"<tool_version>{version()}</tool_version><common_properties>{entries}</common_properties></FHcomment>"
    )


@contextmanager
def _sentence(library: ModuleType) -> Iterator[None]:
    try:
        yield
    except library.blocks.utils.MdfException as cause:
        raise OutputError(f"MF4 cannot hold this ({' '.join(str(cause).split())[:200]}); write .h5 instead.") from cause


def _asammdf() -> ModuleType:
    try:
        return import_module("asammdf")
    except ModuleNotFoundError as cause:
        raise OutputError("MF4 is written by asammdf. Type: pip install 'becalm[formats]'") from cause
