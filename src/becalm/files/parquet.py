"""Read Parquet files block by block with pyarrow. Dictionaries are decoded; units come from the field metadata."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import accumulate
from pathlib import Path
from typing import Any

import pyarrow as pa

from becalm.errors import InputError
from becalm.files.column_statistics import least_bytes
from becalm.files.decoding import PARQUET, Original
from becalm.files.library_reader import refuse_claim
from becalm.files.source import RawTable
from becalm.files.text.csv_header import unique_names

PARQUET_ENDINGS = (".parquet", ".pq")
"""The endings of the names of Parquet files."""

_READ_BYTES = 1 << 20  # buffer for reading


def read_parquet(path: Path, kept: Original | bytes) -> RawTable:
    """Open a Parquet file; its rows are read on demand.

    Parameters
    ----------
    path : Path
        The file.
    kept : Original or bytes
        The state of the file when reading began; for a pipe, its content.

    Raises
    ------
    InputError
        If the file is damaged or has no columns.
    """
    rows = ParquetRows(path, kept)
    if not len(rows.schema):
        raise InputError(f"{path} has no columns; a time and one or more columns of numbers are needed.")
    return RawTable(rows, rows.count, "parquet", units_of(rows.schema))


def units_of(schema: pa.Schema) -> dict[str, str]:
    """Return the units in the metadata of columns, by column name; columns without a unit are left out."""
    return {field.name: unit for field in schema if (unit := _unit(field))}


class ParquetRows:
    """The rows of a Parquet file, read one row group after another.

    Parameters
    ----------
    path : Path
        The file; used only in messages if `kept` holds its bytes.
    kept : Original or bytes
        As in `read_parquet`.

    Raises
    ------
    InputError
        If the file is damaged or has changed, here or when rows are read.
    """

    def __init__(self, path: Path, kept: Original | bytes) -> None:
        self._path, self._kept = path, kept
        with self._explained_errors(), self._open() as file:
            self._stored: pa.Schema = file.schema_arrow
            self._ends = list(accumulate(file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)))
        self.count: int = self._ends[-1] if self._ends else 0
        names = unique_names(self._stored.names)
        fields_bytes = sum(least_bytes(field.type) for field in self._stored)
        size = len(kept) if isinstance(kept, bytes) else path.stat().st_size
        refuse_claim(path, self.count * fields_bytes, size)
        fields = [_plain(field.with_name(name)) for field, name in zip(self._stored, names, strict=True)]
        self.schema: pa.Schema = pa.schema(fields, metadata=self._stored.metadata)
        self._by_name = _are_selectable(self._stored.names)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Yield the named columns from row `start` on, in blocks of up to `most_rows`."""
        positions = [self.schema.names.index(name) for name in names]
        groups = [number for number, end in enumerate(self._ends) if end > start]
        skipped = start - (self._ends[groups[0] - 1] if groups and groups[0] else 0)
        wanted = [self._stored.names[position] for position in sorted(positions)] if self._by_name else None
        with self._explained_errors(names), self._open() as file:
            for batch in self._batches(file, most_rows, groups, wanted):
                self._refuse_changed()
                if skipped >= batch.num_rows:
                    skipped -= batch.num_rows
                    continue
                by_position = dict(zip(_positions(self._stored, wanted), batch.columns, strict=True))
                columns = [self._plain_column(position, by_position[position]) for position in positions]
                schema = pa.schema([self.schema.field(position) for position in positions], self.schema.metadata)
                table = pa.table(columns, schema=schema)
                yield table.slice(skipped) if skipped else table
                skipped = 0

    def close(self) -> None:
        """Do nothing: the file is open only while `blocks` reads it."""

    def _batches(self, file: Any, most_rows: int, groups: list[int], wanted: list[str] | None) -> Iterator[Any]:
        """Yield batches of rows; nested columns are read per row group, since pyarrow cannot always join two groups."""
        nested = any(pa.types.is_nested(self._stored.field(i).type) for i in _positions(self._stored, wanted))
        for together in [[group] for group in groups] if nested else [groups]:
            yield from file.iter_batches(most_rows, row_groups=together, columns=wanted)

    def _plain_column(self, position: int, column: pa.Array) -> pa.Array:
        kind = self.schema.field(position).type
        return column if column.type == kind else column.cast(kind)

    def _open(self) -> Any:
        import pyarrow.parquet as pq

        source = pa.BufferReader(self._kept) if isinstance(self._kept, bytes) else str(self._path)
        file = pq.ParquetFile(source, buffer_size=_READ_BYTES, pre_buffer=False)
        self._refuse_changed()
        return file

    def _refuse_changed(self) -> None:
        if isinstance(self._kept, Original):
            self._kept.refuse_changed()

    @contextmanager
    def _explained_errors(self, names: Sequence[str] = ()) -> Iterator[None]:
        """Turn errors of pyarrow and of the system into an InputError; `names` are the columns that are read."""
        try:
            yield
        except (pa.ArrowException, OSError) as cause:
            self._refuse_changed()
            reason = " ".join(str(cause).split())[:200]
            if isinstance(cause, FileNotFoundError):
                raise InputError(f"{self._path} does not exist any more, or is a link to a missing file.") from cause
            if isinstance(cause, pa.ArrowNotImplementedError):
                nested = [name for name in names if pa.types.is_nested(self.schema.field(name).type)]
                raise InputError(
                    f"{self._path} holds data that cannot be read, in"
                    f" {', '.join(map(repr, nested or names)) or 'a column'} ({reason}); write it again without that"
                    " column, or as plain numbers and text."
                ) from cause
            if not self._begins_as_parquet():
                raise InputError(
                    f"{self._path} is not a Parquet file: its first bytes are those of another format."
                ) from cause
            if self._is_cut():
                raise InputError(
                    f"{self._path} is cut short: the end of a Parquet file describes its columns, and without it the"
                    " file cannot be read; copy or write it again."
                ) from cause
            raise InputError(f"{self._path} is a damaged Parquet file ({reason}); copy or write it again.") from cause

    def _begins_as_parquet(self) -> bool:
        """Return whether the file begins as Parquet; True for an empty file and one that cannot be opened."""
        if isinstance(self._kept, bytes):
            return self._kept[: len(PARQUET)] in (PARQUET, b"")
        with suppress(OSError), self._path.open("rb") as file:
            return file.read(len(PARQUET)) in (PARQUET, b"")
        return True

    def _is_cut(self) -> bool:
        """Return whether the file does not end as Parquet; False if it is too short or cannot be opened."""
        if isinstance(self._kept, bytes):
            return not self._kept.endswith(PARQUET)
        with suppress(OSError), self._path.open("rb") as file:
            file.seek(-len(PARQUET), os.SEEK_END)
            return file.read() != PARQUET
        return False


def _are_selectable(names: Sequence[str]) -> bool:
    """Return whether each name selects one column; a repeated name does not, nor does `a` if there is an `a.b`."""
    distinct = set(names)
    stems = (".".join(name.split(".")[:count]) for name in names for count in range(1, name.count(".") + 1))
    return len(distinct) == len(names) and distinct.isdisjoint(stems)


def _positions(stored: pa.Schema, wanted: Sequence[str] | None) -> list[int]:
    return [position for position, name in enumerate(stored.names) if wanted is None or name in wanted]


def _plain(field: pa.Field) -> pa.Field:
    if pa.types.is_string_view(field.type):
        return field.with_type(pa.string())
    return field.with_type(field.type.value_type) if pa.types.is_dictionary(field.type) else field


def _unit(field: pa.Field) -> str:
    unit: bytes = (field.metadata or {}).get(b"unit", b"")
    return unit.decode("utf-8", "replace").strip()
