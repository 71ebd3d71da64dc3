"""Packed chunks of HDF5 that would unpack to more than their rows: HDF5 gives them whatever room they take."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np

_SPARE = 1 << 16  # bytes that packing may add to what cannot be packed, and checksums
_LARGE = 1 << 20  # packed bytes from which on a chunk is looked into: smaller ones unpack to a gigabyte at the most


def refuse_swollen(dataset: Any) -> None:
    """Refuse a dataset, an h5py.Dataset, some chunk of which unpacks to more than its rows.

    Raises
    ------
    ValueError
        If there is one.
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
    except zlib.error:  # packed otherwise, or damaged: HDF5 says so
        return False
