"""Check the heaps in which HDF5 stores texts: in a damaged one its library loops forever, or allocates any length.

After "HDF5 File Format Specification", III.E and VIII.B: a pointer to a text has its length, heap and number.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_MARK, _HEADER, _OBJECT = b"GCOL\x01\0\0\0", 16, 16
_SMALLEST, _MOST_TEXTS = 4096, 0xFFFF  # smallest heap in bytes, and largest number of texts in one
_POINTER, _LENGTH = struct.Struct("<IQI"), 4
_BLOCK = 1 << 22
_HARMLESS = 1 << 26  # bytes; a virtual dataset points into a heap too, and the bytes before look like such a length


def damaged_heap(path: Path, base: int) -> bool:
    """Return whether a heap is inconsistent, or a text claims to be longer than the file.

    Parameters
    ----------
    path : Path
        The file.
    base : int
        Number of bytes before the HDF5 signature.
    """
    heaps = []
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = data.find(_MARK)
        while at >= 0:
            if at + _HEADER > len(data) or not _is_sound(data, at):
                return True
            heaps.append(at - base)
            at = data.find(_MARK, at + _HEADER)
        return bool(heaps) and _is_too_long(data, np.array(heaps, np.uint64))


def _is_too_long(data: mmap.mmap, heaps: NDArray[np.uint64]) -> bool:
    """Return whether a pointer into the heaps has a length beyond that of the file."""
    for start in range(0, len(data), _BLOCK):
        block = data[max(0, start - _LENGTH) : start + _BLOCK + _POINTER.size]
        for shift in range(min(8, len(block))):
            words = np.frombuffer(block, "<u8", (len(block) - shift) // 8, shift)
            places = np.flatnonzero((words <= heaps[-1]) & (words >= heaps[0]))
            for place in places[np.isin(words[places], heaps)] * 8 + shift:
                if place >= _LENGTH and _claims_more(block[place - _LENGTH : place + 12], max(len(data), _HARMLESS)):
                    return True
    return False


def _claims_more(pointer: bytes, most: int) -> bool:
    """Return whether bytes around a heap's address are a pointer to a text, with a length above `most`."""
    if len(pointer) < _POINTER.size:
        return False
    length, _, number = _POINTER.unpack(pointer)
    return bool(length > most and 0 < number <= _MOST_TEXTS)


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
