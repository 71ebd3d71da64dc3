"""Read NPZ and NPY, NumPy's own files, into memory; nothing is ever unpickled."""

from __future__ import annotations

import io
import zlib
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile, is_zipfile

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from becalm.errors import InputError
from becalm.files.arrays.array_groups import Grouping
from becalm.files.arrays.array_labels import NAME, VARIABLES, apply_labels
from becalm.files.arrays.arrays import FileArrays, Leaf
from becalm.files.groups import tables
from becalm.files.library_reader import LibraryFile
from becalm.files.source import RawTable

_CUT = "The file ends in the middle of {!r}; {} of {} rows are whole and were read."
_HEADER_LETTERS = 1 << 16  # longest header that is read
_READERS = {1: npy.read_array_header_1_0, 2: npy.read_array_header_2_0, 3: npy.read_array_header_2_0}


def read(path: Path) -> tuple[RawTable, ...]:
    """Read the tables of an NPZ or NPY file.

    Raises
    ------
    InputError
        If no array in it can be read.
    """
    library_file = LibraryFile(path, "NPZ")
    contents = FileArrays()
    with library_file.explain_damage():
        with path.open("rb") as file:
            is_npy = file.read(len(npy.MAGIC_PREFIX)) == npy.MAGIC_PREFIX
        if is_npy:
            _read_array(contents, (path.stem or "array",), path.read_bytes())
        else:
            _read_members(contents, library_file)
        apply_labels(contents)
        groups = Grouping(contents, ".", apart=False).groups()
    if not groups and contents.notes:
        raise InputError(f"{path} holds no channel that can be read: {' '.join(contents.notes)[:500]}")
    return tables(library_file, "npz", groups)


def _read_members(contents: FileArrays, library_file: LibraryFile) -> None:
    if not is_zipfile(library_file.path):  # the index at the end of the file is missing
        library_file.cut = True
        raise library_file.no_rows_error()
    with ZipFile(library_file.path) as archive:
        listed = archive.infolist()
        library_file.refuse_claim(sum(member.file_size for member in listed))
        named = [member.filename for member in listed]
        written_by_becalm = {folder for name in named if (folder := name.removesuffix(f"/{VARIABLES}.npy")) != name}
        for member in listed:
            name = member.filename.removesuffix(".npy")
            if name == member.filename:
                continue
            path = tuple(name.split("/"))  # each folder may have its own times
            if len(path) > 1 and "/".join(path[:-1]) not in written_by_becalm:
                contents.words[(*path, NAME)] = (name,)
            try:
                data = archive.read(member)
            except (BadZipFile, NotImplementedError, OSError, RuntimeError, zlib.error) as cause:
                why = " ".join(str(cause).split())[:100] or type(cause).__name__
                contents.notes.append(f"{member.filename!r} is not read: {why}.")
            else:
                _read_array(contents, path, data)


def _read_array(contents: FileArrays, path: tuple[str, ...], data: bytes) -> None:
    """Read one array, or its complete rows."""
    name = "/".join(path)
    file = io.BytesIO(data)
    try:
        version = npy.read_magic(file)
        shape, by_columns, kind = _READERS[version[0]](file, max_header_size=_HEADER_LETTERS)
    except (ValueError, KeyError, EOFError, SyntaxError, TypeError, RecursionError) as cause:
        contents.notes.append(f"{name!r} is not read: {' '.join(str(cause).split())[:100] or 'its header is damaged'}.")
        return
    if kind.hasobject:
        contents.notes.append(f"{name!r} is not read: it holds Python objects, which could run anything.")
        return
    row_bytes = int(np.prod(shape[1:], dtype=object)) * kind.itemsize
    claimed: tuple[int, ...] = ()
    available = len(data) - file.tell()
    rows = available // row_bytes if row_bytes else 0
    if shape and rows < shape[0]:
        if (by_columns and len(shape) > 1) or not rows:
            contents.notes.append(f"{name!r} is not read: the file ends in it.")
            return
        contents.notes.append(_CUT.format(name, rows, shape[0]))
        claimed, shape = shape, (rows, *shape[1:])
    elif not shape and available < kind.itemsize:
        contents.notes.append(f"{name!r} is not read: the file ends in it.")
        return
    count = int(np.prod(shape, dtype=object))
    values = np.frombuffer(data, kind, count, file.tell()).reshape(shape, order="F" if by_columns else "C")
    _hold(contents, path, values, claimed)


def _hold(contents: FileArrays, path: tuple[str, ...], values: NDArray[Any], claimed: tuple[int, ...]) -> None:
    if values.dtype.names:
        for name in values.dtype.names:
            _hold(
                contents, (*path, name), values[name], (*claimed, *values[name].shape[values.ndim :]) if claimed else ()
            )
    elif values.dtype.kind in "biufcSU" or (values.dtype.kind in "mM" and values.dtype.str[4:]):
        contents.add(Leaf.of(path, values)._replace(claimed=claimed))
    else:
        contents.notes.append(
            f"{'.'.join(path)!r} is not read: it holds {values.dtype}, which is neither numbers nor text."
        )
