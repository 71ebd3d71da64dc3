"""Unpack the separately compressed parts of a file, each to at most the size that the file states for it."""

from __future__ import annotations

import bz2
import zlib

from becalm.errors import BecalmError
from becalm.files.library_reader import LibraryFile

ZSTD = b"\x28\xb5\x2f\xfd"  # the first bytes of zstd data


def unpacked(library_file: LibraryFile, compression: str, data: bytes, size: int, cut: bool = False) -> bytes:
    """Unpack a part of a file.

    Parameters
    ----------
    library_file : LibraryFile
        The file.
    compression : str
        "deflate", "zstd", "lz4", "bz2"; "" or "none" for an uncompressed part.
    data : bytes
        The compressed part.
    size : int
        The number of bytes that the part claims to hold; ignored for an uncompressed part.
    cut : bool
        Whether the end of the part is missing; then it may unpack to fewer bytes.

    Raises
    ------
    InputError
        If the library is not installed, or the part claims to be implausibly large.
    ValueError
        If the part is damaged, its compression is unknown, or it does not unpack to `size` bytes.
    """
    if compression in ("", "none"):
        return data
    if size < 0:
        raise ValueError("it does not state its size")
    library_file.refuse_unpacking(size)
    try:
        plain = _plain(library_file, compression, data, size + 1)  # one byte more, to detect a part that holds more
    except BecalmError:
        raise
    except Exception as cause:  # each library raises its own exceptions
        raise ValueError(f"it cannot be unpacked ({cause})") from cause
    if len(plain) != size and not cut:
        raise ValueError(f"it does not hold {size} bytes")
    return plain


def _plain(library_file: LibraryFile, compression: str, data: bytes, size: int) -> bytes:
    if compression == "deflate":
        return zlib.decompressobj().decompress(data, size)
    if compression == "bz2":
        return bz2.BZ2Decompressor().decompress(data, size)
    if compression == "lz4":
        return bytes(library_file.library("lz4.frame").LZ4FrameDecompressor().decompress(data, size))
    if compression == "zstd":
        return bytes(library_file.library("zstandard").ZstdDecompressor().stream_reader(data).read(size))
    raise ValueError(f"the compression {compression!r} is unknown")
