"""Recognise the format of a file by its first bytes, without importing its reader."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import NamedTuple

_MAT4_KINDS = {  # by byte order, valid type codes: 1000 * byte order + 10 * type of number + type of matrix
    order: {thousand + 10 * stored + content for stored in range(6) for content in range(3)}
    for order, thousand in (("<", 0), (">", 1000))
}


def is_mat(head: bytes) -> bool:
    """Return whether a file is MAT version 4, or version 5 (also called 6 or 7)."""
    return is_mat5(head) or is_mat4(head)


def is_mat5(head: bytes) -> bool:
    """Return whether a file is MAT version 5."""
    return head[124:128] in (b"\x00\x01IM", b"\x01\x00MI")


def is_mat4(head: bytes) -> bool:
    """Return whether a file is MAT version 4, by a plausible head of its first variable; it has no signature."""
    for order in "<>":
        if len(head) < 22:
            return False
        kind, rows, columns, imaginary, letters = struct.unpack(order + "IIIII", head[:20])
        name = head[20 : 20 + letters]
        plausible = kind in _MAT4_KINDS[order] and imaginary <= 1 and 2 <= letters <= 64 and rows < 2**31 > columns
        if plausible and name.endswith(b"\0") and name[:-1].decode("latin-1").isidentifier():
            return True
    return False


def is_mat73(head: bytes) -> bool:
    """Return whether a file is MAT version 7.3, which is HDF5 after a block of text."""
    return head.startswith(b"MATLAB 7.3") or head[124:128] in (b"\x00\x02IM", b"\x02\x00MI")


def is_npz(head: bytes) -> bool:
    """Return whether a file is NPY, or NPZ: a ZIP file whose first member is NPY."""
    letters = int.from_bytes(head[26:28], "little")
    return head.startswith(b"\x93NUMPY") or (
        head.startswith(b"PK\x03\x04") and head[30 : 30 + letters].endswith(b".npy")
    )


class LibraryFormat(NamedTuple):
    """A format that is recognised by its first bytes and read by a module of its own.

    Attributes
    ----------
    module : str
        The module within `becalm.files`; its `read` takes the path and returns a table for each time base.
    matches : callable
        Takes the first bytes of a file; returns whether the file has this format.
    """

    module: str
    matches: Callable[[bytes], bool]


LIBRARY_FORMATS: tuple[LibraryFormat, ...] = (
    LibraryFormat("arrays.hdf5", lambda head: head.startswith(b"\x89HDF\r\n\x1a\n")),
    LibraryFormat("recorders.ide", lambda head: head.startswith(b"\x1a\x45\xdf\xa3") and b"mide" in head[:64]),
    LibraryFormat("arrays.mat", is_mat),
    LibraryFormat("arrays.mat73", is_mat73),
    LibraryFormat("robots.mcap", lambda head: head.startswith(b"\x89MCAP0\r\n")),
    LibraryFormat("recorders.mf4", lambda head: head.startswith((b"MDF     ", b"UnFinMF "))),
    LibraryFormat("arrays.npz", is_npz),
    LibraryFormat("robots.rosbag", lambda head: head.startswith((b"#ROSBAG V", b"SQLite format 3\0"))),
    LibraryFormat("recorders.tdms", lambda head: head.startswith(b"TDSm")),
    LibraryFormat(
        "recorders.uff", lambda head: re.match(rb"\s{0,64}-1 *\r?\n(?=[ \d]{6}) *\d+[bB]?\s", head) is not None
    ),
    LibraryFormat("robots.ulog", lambda head: head.startswith(b"ULog\x01\x125")),
    LibraryFormat(
        "recorders.wav", lambda head: head[:4] in (b"RIFF", b"RIFX", b"RF64", b"BW64") and head[8:12] == b"WAVE"
    ),
)
"""The formats, in the order in which they are tried."""
