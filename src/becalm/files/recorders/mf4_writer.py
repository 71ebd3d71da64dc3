"""Write tables to MF4, version 4.10: a channel group for each table; until the end, rows are in temporary files."""

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
from becalm.files.atomic_file import removed_afterwards
from becalm.files.column_arrays import metadata_of, refuse_strange_types
from becalm.files.groups import GROUP, START
from becalm.files.recorders.mf4_tables import MdfTable
from becalm.installation import version

_UTC, _LOCAL = 2, 1  # flags of the time in a header


class Mf4Rows:
    """A writer that appends tables; those of the same becalm group have one schema and share a channel group.

    The master of a group is its first numeric column of times, in s; without one it counts rows. Repeating words are
    codes with a conversion from value to text. Missing whole numbers and flags are invalid samples. Metadata of the
    file are in its history (##FH), and its start time is the first instant.

    Parameters
    ----------
    file : binary file
        The file to write. Until the end, rows are in a temporary folder next to it, if it has a name.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._stack = ExitStack()
        self._library = _asammdf()
        self._log: Any = None
        self._tables: dict[str, MdfTable] = {}
        self._metadata: dict[str, str] = {}

    def write(self, table: pa.Table) -> None:
        """Append rows to the channel group of their table."""
        metadata = metadata_of(table.schema)
        group = metadata.get(GROUP, "")
        if group not in self._tables:
            refuse_strange_types(table.schema, "MF4")
            self._metadata |= {key: text for key, text in metadata.items() if key not in OF_TABLE}
            self._tables[group] = MdfTable(self._library, group, metadata.get(START, ""))
        if self._log is None:
            self._log = self._empty_log()
        with _explain_errors(self._library):
            self._tables[group].write(self._log, table)

    def close(self) -> None:
        """Write all rows; the file itself stays open."""
        if self._log is None:
            return
        self._set_start()
        history = self._library.blocks.v4_blocks.FileHistory()
        # omit the time of writing, so that equal data give equal bytes
        history.abs_time, history.tz_offset, history.daylight_save_time, history.time_flags = 0, 0, 0, _UTC
        history.comment = _comment(self._metadata)
        self._log.file_history.append(history)
        with _explain_errors(self._library):
            for table in self._tables.values():
                table.close(self._log)
            self._log.save(self._file, add_history_block=False)
        self.drop()

    def drop(self) -> None:
        """Remove the temporary files."""
        self._log = None
        with suppress(Exception):  # the temporary files are not needed any more, and may be incomplete
            self._stack.close()

    def _empty_log(self) -> Any:
        """Return an empty log, whose temporary rows are next to the output, where there is enough disk space."""
        folder = None
        if isinstance(getattr(self._file, "name", None), str):
            folder = Path(f"{self._file.name}.rows")
            self._stack.enter_context(removed_afterwards(folder))
            folder.mkdir()
        log = self._library.MDF(version="4.10", temporary_folder=folder)
        self._stack.callback(log.close)
        return log

    def _set_start(self) -> None:
        """Set the start time of the file, and the offset of each group from it."""
        header = self._log.header
        header.abs_time, header.tz_offset, header.daylight_save_time, header.time_flags = 0, 0, 0, _UTC
        dated = [table for table in self._tables.values() if table.zero_ns is not None]
        zoned = bool(dated) and dated[0].start.endswith("Z")
        alike = [table for table in dated if table.start.endswith("Z") == zoned]
        if alike:
            header.abs_time = min(table.zero_ns or 0 for table in alike)
            header.time_flags = _UTC if zoned else _LOCAL
            for table in self._tables.values():
                table.after_ns = (table.zero_ns or 0) - header.abs_time if table in alike else None


def _comment(metadata: Mapping[str, str]) -> str:
    entries = "".join(f"<e name={quoteattr(key)}>{escape(text)}</e>" for key, text in metadata.items())
    return (
        "<FHcomment><TX>Written by becalm</TX><tool_id>becalm</tool_id><tool_vendor>becalm</tool_vendor>"
        f"<tool_version>{version()}</tool_version><common_properties>{entries}</common_properties></FHcomment>"
    )


@contextmanager
def _explain_errors(library: ModuleType) -> Iterator[None]:
    """Turn an error of asammdf into an OutputError."""
    try:
        yield
    except library.blocks.utils.MdfException as cause:
        raise OutputError(f"MF4 cannot hold this ({' '.join(str(cause).split())[:200]}); write .h5 instead.") from cause


def _asammdf() -> ModuleType:
    try:
        return import_module("asammdf")
    except ModuleNotFoundError as cause:
        raise OutputError("Writing MF4 needs asammdf. Type: pip install 'becalm[formats]'") from cause
