"""Reject packed HDF5 chunks that would unpack to more bytes than their rows need; HDF5 would allocate any size."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np

_SPARE = 1 << 16  # bytes that packing and checksums may add to incompressible data
_LARGE = 1 << 20  # packed size in bytes from which a chunk is checked; smaller ones unpack to at most a gigabyte


def check_unpacked_size(dataset: Any) -> None:
    """Raise an error if a chunk of a dataset (an h5py.Dataset) unpacks to more bytes than its rows need.

    Raises
    ------
    ValueError
        If there is such a chunk.
    """
    if dataset.chunks is None or dataset.compression is None:
        return
    plain = int(np.prod(dataset.chunks, dtype=object)) * dataset.id.get_type().get_size()
    most, large = 0, []

    def look(chunk: Any) -> None:
        nonlocal most
        most = max(most, chunk.size)
        if chunk.size > _LARGE and dataset.compression == "gzip" and not chunk.filter_mask:
            large.append(chunk.chunk_offset)

    dataset.id.chunk_iter(look)
    if most > plain + plain // 1000 + _SPARE:
        raise ValueError(f"a chunk of {dataset.name!r} is larger packed than unpacked")
    for offset in large:
        _, packed = dataset.id.read_direct_chunk(offset)
        if _unpacks_beyond(packed, plain + _SPARE):
            raise ValueError(f"a chunk of {dataset.name!r} unpacks to more than its rows")


def _unpacks_beyond(packed: bytes, most: int) -> bool:
    try:
        return len(zlib.decompressobj().decompress(packed, most + 1)) > most
    except zlib.error:  # packed in another way, or damaged; HDF5 will report it
        return False
