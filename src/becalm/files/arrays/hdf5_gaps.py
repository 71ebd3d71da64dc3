"""Mark the chunks of a dataset that were never written; HDF5 returns its fill value for them, usually 0."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from becalm.files.arrays.arrays import Key

_ABSENT = {"M": np.datetime64("NaT"), "m": np.timedelta64("NaT"), "c": complex(np.nan, np.nan), "O": ""}


def is_in_file(chunk: Any, end: int) -> bool:
    """Return whether all bytes of a chunk are in a file of `end` bytes.

    The index of a file that was cut off reads as zeros: chunks of size 0, or at offset 0.
    """
    return bool(chunk.byte_offset > 0 and 0 < chunk.size <= end - chunk.byte_offset)


class WrittenChunks:
    """The chunks of a dataset that are in the file.

    Parameters
    ----------
    dataset : h5py.Dataset
        A dataset in chunks, some of which may be missing.
    rows : int
        Number of rows, on its first axis, to consider.
    end : int
        Length of the file in bytes; chunks beyond it are missing.
    """

    def __init__(self, dataset: Any, rows: int, end: int) -> None:
        self._steps: tuple[int, ...] = dataset.chunks
        self._shape = (rows, *dataset.shape[1:])
        self._present = np.zeros([-(-size // step) for size, step in zip(self._shape, self._steps, strict=True)], bool)

        absent = []

        def visit(chunk: Any) -> None:
            place = tuple(at // step for at, step in zip(chunk.chunk_offset, self._steps, strict=True))
            if any(at >= count for at, count in zip(place, self._present.shape, strict=True)):
                return
            self._present[place] = True
            if not is_in_file(chunk, end):
                absent.append(place)

        dataset.id.chunk_iter(visit)
        for place in absent:  # last, because a damaged index may list a chunk twice
            self._present[place] = False

    @property
    def missing(self) -> int:
        """Return the number of missing chunks."""
        return int(self._present.size - np.count_nonzero(self._present))

    def nullable_type(self, dtype: np.dtype[Any]) -> np.dtype[Any]:
        """Return a type for values of this type and for a missing value.

        Integers and flags become float64; integers of 64 bits, which float64 would round, stay, and are masked.
        """
        return np.dtype(np.float64) if dtype.kind in "biu" and dtype.itemsize < 8 else dtype

    def mark_missing(self, values: NDArray[Any], key: Key) -> NDArray[Any]:
        """Return values with those of missing chunks replaced by the missing value.

        `key` has an index or a slice for each axis of the dataset; further ones, for axes within a field, are ignored.
        """
        axes = [range(size)[part] for size, part in zip(self._shape, key, strict=False)]
        chunks = [np.atleast_1d(np.asarray(one)) // step for one, step in zip(axes, self._steps, strict=True)]
        present = self._present[np.ix_(*chunks)].reshape([len(one) for one in axes if isinstance(one, range)])
        present = present.reshape(present.shape + (1,) * (values.ndim - present.ndim))
        kind = self.nullable_type(values.dtype)
        if kind.kind in "iu":
            return np.ma.masked_array(values, np.broadcast_to(~present, values.shape))
        return np.where(present, values.astype(kind, copy=False), np.array(_ABSENT.get(kind.kind, np.nan), kind))
