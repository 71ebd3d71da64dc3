"""Open HDF5 files, complete or truncated, and find the rows of a dataset that are in the file."""

from __future__ import annotations

import io
import os
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from becalm.files.arrays.hdf5_gaps import WrittenChunks, is_in_file

SIGNATURE = b"\x89HDF\r\n\x1a\n"
_CACHE_BYTES = 8 << 20  # chunk cache of each dataset
_END_AT = {0: 40, 1: 44, 2: 28, 3: 28}  # by version of the superblock: offset of the end-of-file address


class Hdf5File:
    """An HDF5 file.

    Parameters
    ----------
    h5py : module
        The library.
    path : Path
        The file.
    base : int
        Number of bytes before the HDF5 signature; MATLAB writes a header there.

    Attributes
    ----------
    file : h5py.File
        The open file.
    size : int or None
        Number of bytes of a truncated file; None if the file is complete.
    """

    def __init__(self, h5py: ModuleType, path: Path, base: int = 0) -> None:
        self._h5py = h5py
        self.size: int | None = None
        self._base, self._length = base, path.stat().st_size - base
        self._padded: _PaddedFile | None = None
        try:
            self.file = h5py.File(path, "r", rdcc_nbytes=_CACHE_BYTES, locking=False)
        except OSError as cause:
            if "truncated file" not in str(cause):
                raise
            self.size = path.stat().st_size
            self._padded = _PaddedFile(path, _claimed_end(path, base))
            try:
                self.file = h5py.File(self._padded, "r", rdcc_nbytes=_CACHE_BYTES)
            except BaseException:
                self._padded.close()
                raise

    def close(self) -> None:
        """Close the file."""
        self.file.close()
        if self._padded is not None:
            self._padded.close()

    def whole_rows(self, dataset: Any) -> int:
        """Return the number of entries on a dataset's first axis that can be read.

        In a complete file, they end with the last chunk that was written; in a truncated one, before the first chunk
        that is missing. Texts of variable length in a truncated file cannot be read.
        """
        rows = dataset.shape[0] if dataset.shape else 1
        if self.size is None:
            return self._written_rows(dataset, int(rows))
        if self._h5py.check_string_dtype(dataset.dtype) and dataset.dtype.kind == "O":
            return 0  # its texts are stored elsewhere in the file, perhaps beyond its end
        if dataset.chunks is None:
            return self._contiguous_rows(dataset, int(rows))
        for number in range(dataset.id.get_num_chunks()):
            chunk = dataset.id.get_chunk_info(number)
            if not is_in_file(chunk, self._base + self._length):
                rows = min(rows, chunk.chunk_offset[0])
        return int(rows)

    def written(self, dataset: Any, rows: int) -> WrittenChunks | None:
        """Return which chunks of the first `rows` rows are in the file; None if all are, or if there are no chunks."""
        if dataset.chunks is None:
            return None
        chunks = WrittenChunks(dataset, rows, self._base + self._length)
        return chunks if chunks.missing else None

    def _contiguous_rows(self, dataset: Any, rows: int) -> int:
        """Return the number of rows that are in the file, for a dataset without chunks."""
        offset = dataset.id.get_offset()
        # A dataset has no offset if it is stored in its header, or was never written.
        room = dataset.id.get_storage_size() if offset is None else self._length + self._base - offset
        row_bytes = dataset.id.get_type().get_size() * int(np.prod(dataset.shape[1:], dtype=object))
        return int(max(0, min(rows, room // max(row_bytes, 1))))

    def _written_rows(self, dataset: Any, rows: int) -> int:
        """Return the number of rows up to the last written chunk; a logger may enlarge a dataset beforehand."""
        sizes = dataset.chunks
        if sizes is None:
            return self._contiguous_rows(dataset, rows)
        wanted = int(np.prod([-(-size // step) for size, step in zip(dataset.shape, sizes, strict=True)], dtype=object))
        if dataset.id.get_num_chunks() >= wanted:
            return rows
        last = 0

        def visit(chunk: Any) -> None:
            nonlocal last
            last = max(last, chunk.chunk_offset[0] + sizes[0])

        dataset.id.chunk_iter(visit)
        return min(rows, last)


class _PaddedFile(io.RawIOBase):
    """A truncated file that reads as if it had its full length, with zeros beyond its end."""

    def __init__(self, path: Path, length: int) -> None:
        self._file = path.open("rb")
        self._length, self._at = length, 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Set the position, and return it."""
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._length}[whence]
        return self._at

    def tell(self) -> int:
        """Return the position."""
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer from the file, and with zeros beyond its end; return its length in bytes."""
        self._file.seek(self._at)
        count = self._file.readinto(buffer)
        view = memoryview(buffer).cast("B")
        view[count:] = bytes(len(view) - count)
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


def _claimed_end(path: Path, base: int) -> int:
    """Return the length that a file's superblock claims, in bytes."""
    with path.open("rb") as file:
        file.seek(base)
        head = file.read(64)
    at = _END_AT.get(head[8] if len(head) > 8 else -1, 40)
    return int.from_bytes(head[at : at + 8], "little") + base
