"""The heaps in which HDF5 keeps texts, looked over: a damaged one would keep the library busy for ever."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

_MARK, _HEADER, _OBJECT = b"GCOL\x01\0\0\0", 16, 16
_SMALLEST = 4096


def damaged_heap(path: Path) -> bool:
    """Tell whether a heap's objects do not fill it one after another ("HDF5 File Format Specification", III.E)."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = data.find(_MARK)
        while at >= 0:
            if at + _HEADER > len(data) or not _is_sound(data, at):
                return True
            at = data.find(_MARK, at + _HEADER)
    return False


def _is_sound(data: mmap.mmap, at: int) -> bool:
    (size,) = struct.unpack("<Q", data[at + 8 : at + _HEADER])
    if size < _SMALLEST or at + size > len(data):
        return False
    place, end = at + _HEADER, at + size
    while place + _OBJECT <= end:
        index, length = struct.unpack("<H6xQ", data[place : place + _OBJECT])
        need = length if index == 0 else _OBJECT + length + -length % 8
        if need < _OBJECT or place + need > end:
            return False
        place += need
    return True
