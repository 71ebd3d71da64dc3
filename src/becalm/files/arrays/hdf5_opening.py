"""HDF5 files opened, whole or cut short, and which rows of a dataset are really there."""

from __future__ import annotations

import io
import os
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from becalm.files.arrays.hdf5_gaps import WrittenChunks, is_there
from becalm.files.arrays.hdf5_heaps import damaged_heap
from becalm.files.arrays.hdf5_packing import refuse_swollen

SIGNATURE = b"\x89HDF\r\n\x1a\n"
_CACHE_BYTES = 8 << 20
_END_AT = {0: 40, 1: 44, 2: 28, 3: 28}  # where a superblock of that version says how long the file is


class Hdf5File:
    """An HDF5 file.

    Parameters
    ----------
    h5py : module
        The library.
    path : Path
        The file.
    base : int
        Bytes before it, which MATLAB puts there.

    Attributes
    ----------
    file : h5py.File
        As the library gives it.
    size : int or None
        How many bytes there are of a file that is cut short.
    """

    def __init__(self, h5py: ModuleType, path: Path, base: int = 0) -> None:
        self._h5py = h5py
        if damaged_heap(path, base):
            raise OSError("its texts are not where it says, or not as long")
        self.size: int | None = None
        self._base, self._length = base, path.stat().st_size - base
        self._stretched: _Stretched | None = None
        try:
            self.file = h5py.File(path, "r", rdcc_nbytes=_CACHE_BYTES, locking=False)
        except OSError as cause:
            if "truncated file" not in str(cause):
                raise
            self.size = path.stat().st_size
            self._stretched = _Stretched(path, _told_end(path, base))
            try:
                self.file = h5py.File(self._stretched, "r", rdcc_nbytes=_CACHE_BYTES)
            except BaseException:
                self._stretched.close()
                raise

    def close(self) -> None:
        """Close it."""
        self.file.close()
        if self._stretched is not None:
            self._stretched.close()

    def whole_rows(self, dataset: Any) -> int:
        """Return how many entries of a dataset's first axis are before the end of the file.

        Raises
        ------
        ValueError
            If it would unpack to more than its rows.
        """
        refuse_swollen(dataset)
        rows = dataset.shape[0] if dataset.shape else 1
        if self.size is None:
            return self._written_rows(dataset, int(rows))
        if self._h5py.check_string_dtype(dataset.dtype) and dataset.dtype.kind == "O":
            return 0  # its texts are somewhere else
        if dataset.chunks is None:
            return self._contiguous_rows(dataset, int(rows))
        for number in range(dataset.id.get_num_chunks()):
            chunk = dataset.id.get_chunk_info(number)
            if not is_there(chunk, self._length):
                rows = min(rows, chunk.chunk_offset[0])
        return int(rows)

    def written(self, dataset: Any, rows: int) -> WrittenChunks | None:
        """Return which parts of so many rows are in the file; None where all are."""
        if dataset.chunks is None:
            return None
        told = WrittenChunks(dataset, rows, self._length)
        return told if told.missing else None

    def _contiguous_rows(self, dataset: Any, rows: int) -> int:
        """Return how many rows there is room for: in the file, or in the header of a small dataset."""
        offset = dataset.id.get_offset()
        room = dataset.id.get_storage_size() if offset is None else self._length + self._base - offset
        row_bytes = dataset.id.get_type().get_size() * int(np.prod(dataset.shape[1:], dtype=object))
        return int(max(0, min(rows, room // max(row_bytes, 1))))

    def _written_rows(self, dataset: Any, rows: int) -> int:
        """Return how many rows were written of a dataset that a logger made larger beforehand."""
        sizes = dataset.chunks
        if sizes is None:
            return self._contiguous_rows(dataset, rows)
        wanted = int(np.prod([-(-size // step) for size, step in zip(dataset.shape, sizes, strict=True)], dtype=object))
        if dataset.id.get_num_chunks() >= wanted:
            return rows
        last = 0

        def look(chunk: Any) -> None:
            nonlocal last
            last = max(last, chunk.chunk_offset[0] + sizes[0])

        dataset.id.chunk_iter(look)
        return min(rows, last)


class _Stretched(io.RawIOBase):
    """A file cut short that claims its full length: zeros stand beyond its end, which nobody must take for readings."""

    def __init__(self, path: Path, length: int) -> None:
        self._file = path.open("rb")
        self._length, self._at = length, 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move."""
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._length}[whence]
        return self._at

    def tell(self) -> int:
        """Return where it is."""
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer with what is there, and zeros."""
        self._file.seek(self._at)
        there = self._file.readinto(buffer)
        view = memoryview(buffer).cast("B")
        view[there:] = bytes(len(view) - there)
        self._at += len(view)
        return len(view)

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def _told_end(path: Path, base: int) -> int:
    """Return how long a file says that it is."""
    with path.open("rb") as file:
        file.seek(base)
        head = file.read(64)
    at = _END_AT.get(head[8] if len(head) > 8 else -1, 40)
    return int.from_bytes(head[at : at + 8], "little") + base
