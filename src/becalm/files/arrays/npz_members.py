"""Find and read the members of a ZIP archive, also of a truncated one, as far as they are in the file."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import BinaryIO, NamedTuple

from becalm.files.library_reader import Foreign

LOCAL = b"PK\x03\x04"
_HEAD = 30  # bytes of a member's header before its name
_STORED, _PACKED = 0, 8
_ENCRYPTED = 1
_IN_ZIP64 = 0xFFFFFFFF


class Member(NamedTuple):
    """A file in an archive.

    Attributes
    ----------
    name : str
        Its path in the archive.
    at, packed_bytes, bytes : int
        Offset of its content, and the content's packed and unpacked size.
    packed : bool
        Whether it is packed.
    crc : int
        CRC-32 of its unpacked content.
    why : str
        Why it must not be read, or "" if it may.
    """

    name: str
    at: int
    packed_bytes: int
    bytes: int
    packed: bool
    crc: int
    why: str = ""


def members(path: Path) -> tuple[list[Member], bool]:
    """Return the members of an archive, and whether it is complete."""
    try:
        with zipfile.ZipFile(path) as archive:
            starts = [info.header_offset for info in archive.infolist()]
            listed = [(info.file_size, info.compress_size, info.CRC) for info in archive.infolist()]
    except zipfile.BadZipFile:
        return _walked(path), False
    with path.open("rb") as file:
        checked = []
        for start, (size, packed_size, crc) in zip(starts, listed, strict=True):
            member = _local(file, start)
            if member is None:
                raise zipfile.BadZipFile("a member is not where the archive says")
            checked.append(member._replace(bytes=size, packed_bytes=packed_size, crc=crc))
    return checked, True


def _walked(path: Path) -> list[Member]:
    """Return the members by reading their headers one after another, without the archive's index."""
    walked, at = [], 0
    size = path.stat().st_size
    with path.open("rb") as file:
        while at < size:
            member = _local(file, at)
            if member is None or (member.packed_bytes == 0 and member.bytes != 0):
                break
            walked.append(member)
            at = member.at + member.packed_bytes
    return walked


def _local(file: BinaryIO, start: int) -> Member | None:
    file.seek(start)
    head = file.read(_HEAD)
    if len(head) < _HEAD or not head.startswith(LOCAL):
        return None
    _, _, flags, method, _, _, crc, packed, size, letters, more = struct.unpack("<4sHHHHHIIIHH", head)
    name = file.read(letters).decode("utf-8", "replace")
    extra = file.read(more)
    if _IN_ZIP64 in (packed, size) and len(extra) >= 20 and extra[:2] == b"\x01\x00":
        size, packed = struct.unpack("<QQ", extra[4:20])
    why = ""
    if flags & _ENCRYPTED:
        why = "it is encrypted"
    elif method not in (_STORED, _PACKED):
        why = f"it is packed by method {method}, which becalm cannot unpack"
    elif PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name.replace("\\", "/")).parts:
        why = "its name leads out of the archive"
    return Member(name, start + _HEAD + letters + more, packed, size, method == _PACKED, crc, why)


def content(foreign: Foreign, member: Member) -> tuple[bytes, bool]:
    """Return the bytes of a member as far as they are in the file, and whether they are complete and undamaged.

    Raises
    ------
    InputError
        If the member claims an absurd size.
    """
    foreign.refuse_claim(member.bytes)
    with foreign.path.open("rb") as file:
        file.seek(member.at)
        data = file.read(min(member.packed_bytes, foreign.path.stat().st_size))
    if member.packed:
        try:
            data = zlib.decompressobj(-15).decompress(data, member.bytes) if member.bytes else b""
        except zlib.error:
            return b"", False
    return data, len(data) == member.bytes and zlib.crc32(data) == member.crc
