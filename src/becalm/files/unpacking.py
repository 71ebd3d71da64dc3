"""Parts of a file that are compressed each for itself: unpacked to what they claim to hold, and no more."""

from __future__ import annotations

import bz2
import zlib

from becalm.errors import BecalmError
from becalm.files.library_reader import Foreign

ZSTD = b"\x28\xb5\x2f\xfd"


def unpacked(foreign: Foreign, compression: str, data: bytes, size: int, cut: bool = False) -> bytes:
    """Unpack a part of a file.

    Parameters
    ----------
    foreign : Foreign
        The file.
    compression : str
        "deflate", "zstd", "lz4", "bz2", or "" and "none".
    data : bytes
        What is compressed.
    size : int
        How many bytes it claims to be.
    cut : bool
        Whether its end is missing; then what is before that is unpacked.

    Raises
    ------
    InputError
        If the library is missing, or the part claims to be absurdly large.
    ValueError
        If it is damaged, or not of that size.
    """
    if compression in ("", "none"):
        return data
    if size < 0:
        raise ValueError("it does not tell its size")
    foreign.refuse_unpacking(size)
    try:
        plain = _plain(foreign, compression, data, size + 1)  # one more, to see whether there is more
    except BecalmError:
        raise
    except Exception as cause:  # each library's own
        raise ValueError(f"it cannot be unpacked ({cause})") from cause
    if len(plain) != size and not cut:
        raise ValueError(f"it does not hold {size} bytes")
    return plain


def _plain(foreign: Foreign, compression: str, data: bytes, size: int) -> bytes:
    if compression == "deflate":
        return zlib.decompressobj().decompress(data, size)
    if compression == "bz2":
        return bz2.BZ2Decompressor().decompress(data, size)
    if compression == "lz4":
        return bytes(foreign.library("lz4.frame").LZ4FrameDecompressor().decompress(data, size))
    if compression == "zstd":
        return bytes(foreign.library("zstandard").ZstdDecompressor().stream_reader(data).read(size))
    raise ValueError(f"the compression {compression!r} is unknown")
