"""Parquet: pyarrow's own table; dictionaries are decoded, units come from the field metadata."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa

from becalm.errors import InputError
from becalm.files.csv_reader import unique_names
from becalm.files.source import RawTable


def read_parquet(path: Path, data: bytes) -> RawTable:
    """Read the bytes of a Parquet file.

    Raises
    ------
    InputError
        If the file is damaged or has no columns.
    """
    import pyarrow.parquet as pq

    try:
        table = pq.ParquetFile(pa.BufferReader(data)).read()
    except (pa.ArrowException, OSError) as cause:
        reason = " ".join(str(cause).split())[:200]
        raise InputError(f"{path} is a damaged Parquet file ({reason}); copy or write it again.") from cause
    if not table.num_columns:
        raise InputError(f"{path} has no columns; a time and one or more columns of numbers are needed.")
    table = table.rename_columns(unique_names(table.column_names))
    for position, field in enumerate(table.schema):
        if pa.types.is_string_view(field.type):
            table = table.set_column(position, field.with_type(pa.string()), table.column(position).cast(pa.string()))
        if pa.types.is_dictionary(field.type):
            plain = table.column(position).cast(field.type.value_type)
            table = table.set_column(position, field.with_type(field.type.value_type), plain)
    return RawTable(table, "parquet", {field.name: unit for field in table.schema if (unit := _unit(field))})


def _unit(field: pa.Field) -> str:
    told: bytes = (field.metadata or {}).get(b"unit", b"")
    return told.decode("utf-8", "replace").strip()
