"""Read a folder of Parquet files as one table, with its files in the order of time."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from becalm.errors import InputError
from becalm.files.decoding import Original
from becalm.files.lake.listing import parquet_files
from becalm.files.lake.order import order_of_time
from becalm.files.lake.partitions import refuse_several
from becalm.files.parquet import ParquetRows, read_parquet
from becalm.files.source import RawTable


class LakeFile(NamedTuple):
    """The path and the number of rows of a file in the folder."""

    path: Path
    rows: int


class Originals(Original):
    """The states of a folder's files when reading began; a file that is added later is not a change.

    Parameters
    ----------
    folder : Path
        The folder.
    files : mapping of Path to Original
        The state of each file, by its path.
    """

    def __init__(self, folder: Path, files: Mapping[Path, Original]) -> None:
        self._folder, self._files = folder, files

    def of(self, path: Path) -> Original:
        """Return the original state of one file."""
        return self._files[path]

    def refuse_changed(self) -> None:
        """Refuse files that changed since reading began.

        Raises
        ------
        InputError
            If a file was replaced, written to or removed.
        """
        for original in self._files.values():
            original.refuse_changed()

    def sha256(self) -> str:
        """Return the SHA-256, as hexadecimal digits, of the names and hashes of all files, sorted by name.

        Raises
        ------
        InputError
            If a file cannot be read, or changed since reading began.
        """
        digest = hashlib.sha256()
        for name, path in sorted((os.fsencode(path.relative_to(self._folder)), path) for path in self._files):
            digest.update(name + b"\0" + self._files[path].sha256().encode() + b"\n")
        return digest.hexdigest()


class FolderRows:
    """The rows of several Parquet files one after the other; a file is open only while its rows are read.

    Parameters
    ----------
    schema : pyarrow.Schema
        The schema of all files; in a file, columns may be in any order.
    pieces : sequence of LakeFile
        The files, in the order of their rows.
    originals : Originals
        The state of the same files when reading began.

    Attributes
    ----------
    pieces : tuple of LakeFile
        The files, in the order of their rows.
    """

    def __init__(self, schema: pa.Schema, pieces: Sequence[LakeFile], originals: Originals) -> None:
        self.schema, self.pieces, self._originals = schema, tuple(pieces), originals
        self.count: int = sum(piece.rows for piece in self.pieces)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Yield the named columns from row `start` on, in blocks of up to `most_rows`."""
        schema = pa.schema([self.schema.field(name) for name in names], self.schema.metadata)
        begins = accumulate((piece.rows for piece in self.pieces), initial=0)
        for (path, rows), first in zip(self.pieces, begins, strict=False):  # `begins` has one entry more
            if first + rows > start:
                own = ParquetRows(path, self._originals.of(path))
                for block in own.blocks(names, most_rows, max(0, start - first)):
                    yield pa.table(block.columns, schema=schema)

    def close(self) -> None:
        """Do nothing: files are open only while `blocks` reads them."""


def read_folder(folder: Path, only: Sequence[Path] = ()) -> RawTable:
    """Open the Parquet files of a folder, and sort them by time.

    Parameters
    ----------
    folder : Path
        The folder.
    only : sequence of Path
        The files to read; all files of the folder if it is empty.

    Raises
    ------
    InputError
        If there are no files, a file is damaged, the files differ in their columns, or they belong to several sensors.
    """
    files, notes = (only, ()) if only else parquet_files(folder)
    if not only:
        refuse_several(folder, files)
    originals = Originals(folder, {path: Original(path) for path in files})
    tables = [(path, read_parquet(path, originals.of(path))) for path in files]
    with_rows = [one for one in tables if one[1].count]
    for path, table in with_rows[1:]:
        refuse_different(path, table, *with_rows[0])
    order = order_of_time([table for _, table in with_rows]) if with_rows else []
    pieces = [LakeFile(with_rows[number][0], with_rows[number][1].count) for number in order]
    first = with_rows[order[0]][1] if with_rows else tables[0][1]
    schema = pa.schema([field.with_nullable(True) for field in first.rows.schema], first.rows.schema.metadata)
    rows = FolderRows(schema, pieces, originals)
    return replace(first, rows=rows, count=rows.count, original=originals, notes=notes, joined=_joined(rows))


def refuse_different(path: Path, table: RawTable, other: Path, first: RawTable) -> None:
    """Refuse a file whose columns, types or units differ from those of the first file.

    Raises
    ------
    InputError
        If they differ.
    """
    if lacks := [name for name in first.names if name not in table.names]:
        raise _difference_error(path, f"lacks the column {lacks[0]!r} that {other} has")
    if more := [name for name in table.names if name not in first.names]:
        raise _difference_error(path, f"has a column {more[0]!r} that {other} lacks")
    for name in first.names:
        own, its = table.type_of(name), first.type_of(name)
        if own != its:
            raise _difference_error(path, f"holds {name!r} as {own}, and {other} as {its}")
        unit, wanted = table.units.get(name, ""), first.units.get(name, "")
        if unit != wanted:
            raise _difference_error(path, f"has {name!r} in {unit or 'no unit'}, and {other} in {wanted or 'no unit'}")


def _difference_error(path: Path, how: str) -> InputError:
    return InputError(
        f"{path} {how}; the files of a folder are read as one recording, so all need the same columns. Write it again"
        " like the others, or give the path of one file."
    )


def _joined(rows: FolderRows) -> str:
    """Return a sentence that names the files that the rows come from, "" for a single file."""
    if len(rows.pieces) < 2:
        return ""
    return (
        f"The rows are those of {len(rows.pieces):,} files in the order of their first stamps, from"
        f" {rows.pieces[0].path.name} to {rows.pieces[-1].path.name}: files that overlap in time are not one recording;"
        " give the path of one file, or move the others elsewhere."
    )
