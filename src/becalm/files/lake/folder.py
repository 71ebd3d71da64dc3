"""A folder of Parquet files read as one table: the rows of all of them, in the order of time."""

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
from becalm.files.identity import Original
from becalm.files.lake.listing import parquet_files
from becalm.files.lake.order import order_of_time
from becalm.files.lake.partitions import refuse_several
from becalm.files.parquet import ParquetRows, read_parquet
from becalm.files.source import RawTable


class LakeFile(NamedTuple):
    """One of the files: its path, and how many rows it has."""

    path: Path
    rows: int


class Originals(Original):
    """The files of a folder as they were when reading began; what comes into the folder later is not of it.

    Parameters
    ----------
    folder : Path
        That they are in.
    files : mapping of Path to Original
        Each of them.
    """

    def __init__(self, folder: Path, files: Mapping[Path, Original]) -> None:
        self._folder, self._files = folder, files

    def of(self, path: Path) -> Original:
        """Return one of them."""
        return self._files[path]

    def refuse_changed(self) -> None:
        """Compare the files with what they were.

        Raises
        ------
        InputError
            If one was replaced, written to or removed.
        """
        for original in self._files.values():
            original.refuse_changed()

    def sha256(self) -> str:
        """Return the SHA-256, as hexadecimal digits, of the names in the folder and the hashes of the files, by name.

        Raises
        ------
        InputError
            If a file cannot be read, or is not what it was.
        """
        digest = hashlib.sha256()
        for name, path in sorted((os.fsencode(path.relative_to(self._folder)), path) for path in self._files):
            digest.update(name + b"\0" + self._files[path].sha256().encode() + b"\n")
        return digest.hexdigest()


class FolderRows:
    """The rows of Parquet files one after the other, each opened when it is its turn.

    Parameters
    ----------
    schema : pyarrow.Schema
        Of all of them; their columns may come in any order.
    pieces : sequence of LakeFile
        The files, in the order of their rows.
    originals : Originals
        The same files as they were when reading began.

    Attributes
    ----------
    pieces : tuple of LakeFile
        As given.
    """

    def __init__(self, schema: pa.Schema, pieces: Sequence[LakeFile], originals: Originals) -> None:
        self.schema, self.pieces, self._originals = schema, tuple(pieces), originals
        self.count: int = sum(piece.rows for piece in self.pieces)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Read the files from the one on that row `start` is in, only the columns that are asked for."""
        schema = pa.schema([self.schema.field(name) for name in names], self.schema.metadata)
        begins = accumulate((piece.rows for piece in self.pieces), initial=0)
        for (path, rows), first in zip(self.pieces, begins, strict=False):  # the last of them is where all end
            if first + rows > start:
                own = ParquetRows(path, self._originals.of(path))
                for block in own.blocks(names, most_rows, max(0, start - first)):
                    yield pa.table(block.columns, schema=schema)

    def close(self) -> None:
        """Do nothing: each file is opened anew for each reading."""


def read_folder(folder: Path, only: Sequence[Path] = ()) -> RawTable:
    """Look into the Parquet files of a folder, and put them in the order of time.

    Parameters
    ----------
    folder : Path
        The folder.
    only : sequence of Path
        Files in it, where not all are meant.

    Raises
    ------
    InputError
        If there is none, one is damaged, they have not the same columns, or they are of several sensors.
    """
    files, notes = (only, ()) if only else parquet_files(folder)
    if not only:
        refuse_several(folder, files)
    originals = Originals(folder, {path: Original(path) for path in files})
    read = [(path, read_parquet(path, originals.of(path))) for path in files]
    held = [one for one in read if one[1].count]
    for path, table in held[1:]:
        refuse_different(path, table, *held[0])
    order = order_of_time([table for _, table in held]) if held else []
    pieces = [LakeFile(held[number][0], held[number][1].count) for number in order]
    first = held[order[0]][1] if held else read[0][1]
    schema = pa.schema([field.with_nullable(True) for field in first.rows.schema], first.rows.schema.metadata)
    rows = FolderRows(schema, pieces, originals)
    return replace(first, rows=rows, count=rows.count, original=originals, notes=notes, joined=_joined(rows))


def refuse_different(path: Path, table: RawTable, other: Path, first: RawTable) -> None:
    """Refuse a file that has not the columns, types and units of the first one.

    Raises
    ------
    InputError
        If it differs.
    """
    if lacks := [name for name in first.names if name not in table.names]:
        raise _different(path, f"lacks the column {lacks[0]!r} that {other} has")
    if more := [name for name in table.names if name not in first.names]:
        raise _different(path, f"has a column {more[0]!r} that {other} lacks")
    for name in first.names:
        own, its = table.type_of(name), first.type_of(name)
        if own != its:
            raise _different(path, f"holds {name!r} as {own}, and {other} as {its}")
        unit, wanted = table.units.get(name, ""), first.units.get(name, "")
        if unit != wanted:
            raise _different(path, f"has {name!r} in {unit or 'no unit'}, and {other} in {wanted or 'no unit'}")


def _different(path: Path, how: str) -> InputError:
    return InputError(
        f"{path} {how}; the files of a folder are one recording where all have the same columns. Write it again as the"
        " others are, or give the path of one file."
    )


def _joined(rows: FolderRows) -> str:
    """Say of which files the rows are."""
    if len(rows.pieces) < 2:
        return ""
    return (
        f"The rows are those of {len(rows.pieces):,} files in the order of their first stamps, from"
        f" {rows.pieces[0].path.name} to {rows.pieces[-1].path.name}: files that overlap in time are no one recording;"
        " give the path of one file, or move the others elsewhere."
    )
