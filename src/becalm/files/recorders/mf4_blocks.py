"""Check the blocks of an MDF 4 file before it is read, and repair truncated and unfinished ones in a copy."""

from __future__ import annotations

import re
import shutil
import struct
from collections.abc import Iterator
from mmap import ACCESS_READ, mmap
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, NamedTuple

from becalm.files.libraries.unpacking import unpacked
from becalm.files.library_reader import LibraryFile

_HEADER_LINKS = 88  # offset of the links of the first block, ##HD, in the file
_HEAD = 24  # bytes of a block before its links
_FLAGS = 60  # offset of two bytes of flags that list what the recorder did not finish
_VERSION = 8  # offset of the version
# Flags of what is not final: the counts of rows, the length of the last block of data, the last list of blocks.
_COUNTERS, _LAST_LENGTH, _LAST_LIST = 0x1, 0x4, 0x10
_MOST_BLOCKS = 1_000_000  # a file with more counts as a ring of blocks
_PACKED = struct.Struct("<B5xQQ")  # at byte 26 of a ##DZ: method, unpacked and packed size
_PACKED_AT, _PACKED_HEAD = 26, 48  # offsets of these numbers and of the packed data, in the block
_PACKINGS = ("deflate", "deflate", "zstd", "zstd", "lz4", "lz4")  # by method; methods 1, 3 and 5 are also transposed
_COUNTED = (3, 6)  # types of virtual channels, which have no bytes in the rows
_MAY_BE_INVALID = 2  # flag of a channel whose rows have a bit of validity
_NUMBERS = (b"##DT", b"##DV", b"##DI", b"##SD", b"##RD", b"##RV", b"##RI")  # blocks of data
_ALL = -1  # stands for all links of a block
_FOLLOWED: dict[bytes, tuple[int, ...]] = {
    b"##DG": (0, 1, 2),
    b"##CG": (0, 1),
    b"##CN": (0, 1, 5),
    b"##CA": (0,),
    b"##FH": (0,),
    b"##AT": (0,),
    b"##EV": (0,),
    b"##CH": (0,),
    b"##HL": (0,),
    b"##DL": (_ALL,),
    b"##LD": (_ALL,),
}
"""By kind of block, the numbers of the links to follow; each followed block is the target of one such link."""
_ANY = re.compile(rb"##[A-Z]{2}\0{4}")  # the first bytes of any block


class _Link(NamedTuple):
    """A link to a block that is still to be checked; offsets are in bytes from the start of the file."""

    place: int  # offset of the link
    source: bytes  # kind of the block that contains it
    group: int = 0  # offset of its data group
    channels: int = 0  # offset of its channel group


class Repairs(NamedTuple):
    """The repairs that a copy of a file needs before it can be read.

    Attributes
    ----------
    patches : dict of int to bytes
        Bytes to write, by their offset; empty if the file can be read without repair.
    cut : bool
        Whether blocks, or parts of them, are missing.
    """

    patches: dict[int, bytes]
    cut: bool

    def open_file(self, path: Path) -> IO[bytes]:
        """Open the file, or a repaired temporary copy that is removed when closed."""
        if not self.patches:
            return path.open("rb")
        copy = TemporaryFile()  # noqa: SIM115 - the caller closes it
        with path.open("rb") as file:
            shutil.copyfileobj(file, copy)
        for place, change in self.patches.items():
            copy.seek(place)
            copy.write(change)
        copy.seek(0)
        return copy


def check_blocks(library_file: LibraryFile) -> Repairs:
    """Follow the blocks of a file of version 4 and return the repairs that it needs.

    Raises
    ------
    InputError
        If packed blocks claim more data than a file of this size can hold.
    ValueError
        If blocks form a ring, there are far too many, or one is inconsistent.
    """
    with library_file.path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
        if data[_VERSION : _VERSION + 1] != b"4":  # other versions do not have these blocks
            return Repairs({}, False)
        if len(data) < _HEADER_LINKS + 48 or data[64:68] != b"##HD":
            raise ValueError("it has no header block")
        (flags,) = struct.unpack_from("<H", data, _FLAGS)
        patches: dict[int, bytes] = {}
        cut, chained = _follow(library_file, data, flags, patches)
        left = flags & ~_LAST_LENGTH | (_COUNTERS if patches else 0)
        if chained and left & _LAST_LIST:  # asammdf completes a single list, but loops forever in a chain of lists
            left, cut = left & ~_LAST_LIST, True
        if patches or flags:
            patches |= {0: b"UnFinMF " if left else b"MDF     ", _FLAGS: struct.pack("<H", left)}
        return Repairs(patches, cut)


def _follow(library_file: LibraryFile, data: mmap, flags: int, patches: dict[int, bytes]) -> tuple[bool, bool]:
    """Follow all blocks, and add patches for links to missing blocks and for wrong lengths.

    Returns
    -------
    cut : bool
        Whether data are missing.
    chained : bool
        Whether a list of blocks continues in another list.
    """
    cut = chained = False
    seen: set[int] = set()
    todo = [_Link(_HEADER_LINKS + 8 * number, b"##HD") for number in range(5)]
    while todo:
        link = todo.pop()
        (address,) = struct.unpack_from("<Q", data, link.place)
        if not address:
            continue
        if not _is_block(data, address):
            patches[link.place], cut = bytes(8), True
            continue
        kind, length = bytes(data[address : address + 4]), _length(data, address)
        if link.source == b"##CN" and kind == b"##CG":  # shared with the chain of groups
            continue
        if address in seen or len(seen) > _MOST_BLOCKS:
            raise ValueError(f"its blocks form a ring at {address:#x}")
        seen.add(address)
        chained |= link.source == kind == b"##DL"
        available = len(data) - address
        if kind in _NUMBERS and (length > available or _is_open(flags, link, length)):
            stop = _next_block(data, address)
            patches[address + 8] = struct.pack("<Q", stop - address)
            cut = cut or length > available
            if kind == b"##SD":
                _shorten(data, link.group, address, patches)
        elif length > available:
            patches[link.place], cut = bytes(8), True
        else:
            _check_claims(library_file, data, address, kind, link.channels)
            todo += _links(data, address, kind, link)
    return cut, chained


def _check_claims(library_file: LibraryFile, data: mmap, address: int, kind: bytes, channels: int) -> None:
    """Raise an error for a size or offset that is wrong; asammdf does not check it, and would return wrong numbers."""
    if kind == b"##DZ":
        _check_packed(library_file, data, address)
    elif kind == b"##CN":
        _check_channel(data, address, channels)


def _check_packed(library_file: LibraryFile, data: mmap, address: int) -> None:
    """Raise an error if a packed block has another size than it claims; asammdf would return wrong numbers."""
    how, plain, packed = _PACKED.unpack_from(data, address + _PACKED_AT)
    if how >= len(_PACKINGS) or packed > _length(data, address) - _PACKED_HEAD:
        raise ValueError(f"the block at {address:#x} is packed in an unknown way, or beyond its end")
    if plain:
        at = address + _PACKED_HEAD
        unpacked(library_file, _PACKINGS[how], data[at : at + packed], plain)


def _is_open(flags: int, link: _Link, length: int) -> bool:
    """Return whether the recorder did not write the final length of a block of data."""
    return bool(flags & _LAST_LENGTH) and (length <= _HEAD or link.source == b"##DG")


def _is_block(data: mmap, address: int) -> bool:
    return address + _HEAD <= len(data) and data[address : address + 2] == b"##"


def _length(data: mmap, address: int) -> int:
    return int(struct.unpack_from("<Q", data, address + 8)[0])


def _links(data: mmap, address: int, kind: bytes, link: _Link) -> Iterator[_Link]:
    (count,) = struct.unpack_from("<Q", data, address + 16)
    if _HEAD + 8 * count > _length(data, address):
        raise ValueError(f"a block at {address:#x} has {count} links in {_length(data, address)} bytes")
    numbers = _FOLLOWED.get(kind, ())
    group = address if kind == b"##DG" else link.group
    channels = address if kind == b"##CG" else link.channels
    for number in range(count) if _ALL in numbers else numbers:
        if number < count:
            yield _Link(address + _HEAD + 8 * number, kind, group, channels)


def _next_block(data: mmap, address: int) -> int:
    """Return the offset of the next block, or of the end of the file."""
    for match in _ANY.finditer(data, address + _HEAD):
        if match.start() % 8 == 0:
            return match.start()
    return len(data)


def _shorten(data: mmap, group: int, texts: int, patches: dict[int, bytes]) -> None:
    """Shorten a truncated block of texts to its complete texts, and the rows of their group to as many."""
    stop, rows = _whole_texts(data, texts + _HEAD, len(data))
    patches[texts + 8] = struct.pack("<Q", stop - texts)
    channels, numbers = struct.unpack_from("<QQ", data, group + _HEAD + 8)
    if data[group + 56] or not _is_block(data, numbers) or data[numbers : numbers + 4] != b"##DT":
        return  # the rows are mixed with those of other groups, or in several blocks
    width = sum(_widths(data, channels))
    patches[numbers + 8] = struct.pack("<Q", min(_HEAD + rows * width, len(data) - numbers))


def _whole_texts(data: mmap, at: int, end: int) -> tuple[int, int]:
    """Return the end of a block's last complete text, and the number of texts; each begins with its length."""
    count = 0
    while at + 4 <= end:
        (length,) = struct.unpack_from("<I", data, at)
        if at + 4 + length > end:
            break
        at, count = at + 4 + length, count + 1
    return at, count


def _body(data: mmap, address: int) -> int:
    """Return the offset of a block's data after its links."""
    return address + _HEAD + 8 * int(struct.unpack_from("<Q", data, address + 16)[0])


def _widths(data: mmap, channels: int) -> tuple[int, int]:
    """Return the bytes in a row of a channel group: for samples, and for bits that mark invalid samples."""
    samples, invalid = struct.unpack_from("<II", data, _body(data, channels) + 24)
    return int(samples), int(invalid)


def _check_channel(data: mmap, channel: int, channels: int) -> None:
    """Raise an error if a channel lies outside its rows, because asammdf's C code would read beyond them."""
    samples, invalid = _widths(data, channels)
    kind, bit, byte, bits, flags, invalid_bit = struct.unpack_from("<BxxBIIII", data, _body(data, channel))
    if kind not in _COUNTED and 8 * byte + bit + bits > 8 * samples:
        raise ValueError(f"a channel at byte {byte} lies outside rows of {samples} bytes")
    if flags & _MAY_BE_INVALID and invalid_bit >= 8 * invalid:
        raise ValueError(f"a bit of validity, {invalid_bit}, lies outside rows with {invalid} bytes of them")
