"""Write tables to TDMS: a group for each table, a channel for each column, a segment for each chunk of rows."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from importlib import import_module
from types import ModuleType
from typing import IO, Any

import pyarrow as pa

from becalm.errors import OutputError
from becalm.files.arrays.array_labels import OF_TABLE
from becalm.files.column_arrays import (
    FillValues,
    is_text,
    metadata_of,
    numbers_of,
    refuse_strange_types,
    texts_of,
    unit_of_field,
)
from becalm.files.groups import GROUP

FILL = "_FillValue"
"""Property of a channel: the whole number that marks a missing value."""

_NAMELESS = "recording"  # TDMS group of a table whose own group has no name


class TdmsRows:
    """A writer that appends tables; those of the same becalm group have one schema and share a TDMS group.

    Each channel has its unit as `unit_string`; words and dates are texts. Missing whole numbers have the value of the
    property `_FillValue`. Metadata of the file are properties of the file, metadata of a table those of its group.

    Parameters
    ----------
    file : binary file
        The file to write.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._library = _nptdms()
        self._out = self._library.TdmsWriter(file)
        self._groups: dict[str, str] = {}
        self._fills: defaultdict[str, FillValues] = defaultdict(FillValues)  # by TDMS group
        self._out.open()

    def write(self, table: pa.Table) -> None:
        """Append rows to the TDMS group of their table."""
        metadata = metadata_of(table.schema)
        group = metadata.get(GROUP, "")
        if group not in self._groups:
            refuse_strange_types(table.schema, "TDMS")
            self._begin(group, metadata)
        if table.num_rows:
            channels = zip(table.schema, table.columns, strict=True)
            name = self._groups[group]
            self._out.write_segment([self._channel(name, field, column) for field, column in channels])

    def close(self) -> None:
        """Finish writing; the file itself stays open."""
        if not self._groups:
            self._out.write_segment([self._library.RootObject()])
        self._out.close()

    def drop(self) -> None:
        """Stop writing and discard the result."""
        self._out.close()

    def _begin(self, group: str, metadata: Mapping[str, str]) -> None:
        """Write the metadata of a group and of the file."""
        names = (group or _NAMELESS, *(f"{_NAMELESS} {number}" for number in range(2, len(self._groups) + 3)))
        self._groups[group] = next(name for name in names if name not in self._groups.values())
        of_file = {key: text for key, text in metadata.items() if key not in OF_TABLE}
        of_group = {GROUP: "", **{key: text for key, text in metadata.items() if key in OF_TABLE}}
        library = self._library
        self._out.write_segment(
            [library.RootObject(of_file), library.GroupObject(self._groups[group], properties=of_group)]
        )

    def _channel(self, group: str, field: pa.Field, column: pa.ChunkedArray) -> Any:
        properties = dict(_properties(field))
        if is_text(column.type):
            return self._library.ChannelObject(group, field.name, texts_of(column), properties)
        values, missing = numbers_of(column)
        if values.dtype.kind == "b" and missing.any():
            raise OutputError(f"{field.name!r} has missing flags, which TDMS cannot represent; write .h5 instead.")
        if values.dtype.kind in "iu":
            fills = self._fills[group]
            values = fills.filled(field.name, values, missing)
            if (fill := fills.of(field.name, values.dtype)) is not None:
                properties[FILL] = fill
        return self._library.ChannelObject(group, field.name, values, properties)


def _properties(field: pa.Field) -> Iterator[tuple[str, Any]]:
    if unit := unit_of_field(field):
        yield "unit_string", unit


def _nptdms() -> ModuleType:
    try:
        return import_module("nptdms")
    except ModuleNotFoundError as cause:
        raise OutputError("Writing TDMS needs npTDMS. Type: pip install 'becalm[formats]'") from cause
