"""Find, unpack and check the variables of MAT files as bytes, before a library trusts the sizes that they claim.

Version 5 after "MAT-File Format", MathWorks: each element begins with a tag of type and length, and may be nested.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

from becalm.files.library_reader import Foreign

MATRIX, _COMPRESSED = 14, 15
CELL, STRUCT, OBJECT, CHAR, _SPARSE, _FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
_VALUES = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13}
_LETTERS = {1, 2, 3, 4, 16, 17, 18}
_TYPES = _VALUES | _LETTERS | {MATRIX}
_FEWEST_PARTS = {CELL: 3, STRUCT: 5, OBJECT: 6}
_COMPLEX = 0x800
_DEEPEST = 32  # nesting of structs; deeper nesting would overflow a library's stack
_SPARE = 1024
_NUMBERS4 = (8, 4, 4, 2, 2, 1)  # bytes of a value, by the digit P of a type in version 4


SPARSE = "it is a sparse matrix; save it from MATLAB as full(A)"
"""Message: why a sparse matrix is not read, and what to do."""


class Variable(NamedTuple):
    """One variable.

    Attributes
    ----------
    name : str
        Its name; "" if damage makes it unreadable.
    data : bytes
        Its unpacked element; in version 4, a file with only this variable. Empty if it must not be read.
    why : str
        Why it must not be read; else "".
    order : str
        Byte order, "<" or ">"; "" in version 4.
    """

    name: str
    data: bytes
    why: str = ""
    order: str = ""


class MatElement(NamedTuple):
    """An element within an element: its type, the offset of its bytes, and their number."""

    kind: int
    start: int
    length: int


class DamageError(Exception):
    """An element is damaged; the message says how."""


def variables5(foreign: Foreign, data: memoryview) -> Iterator[Variable]:
    """Yield the unpacked variables of a file of version 5; a last, truncated one has no data."""
    order = "<" if bytes(data[126:128]) == b"IM" else ">"
    unpacked, at = 0, 128
    while at < len(data):
        if at + 8 > len(data):
            yield Variable("", b"", "the file ends in it")
            return
        kind, length = struct.unpack(order + "II", data[at : at + 8])
        end = at + 8 + length
        element, whole = data[at : min(end, len(data))], end <= len(data)
        if kind == _COMPRESSED:
            element, whole = _unpacked(element[8:], foreign, unpacked, order)
            unpacked += len(element)
        elif kind != MATRIX:
            yield Variable("", b"", f"it begins with the type {kind}, which does not exist")
            return
        yield _checked(element, order, whole)
        at = end if kind == _COMPRESSED else end + -length % 8


def variables4(data: memoryview) -> Iterator[Variable]:
    """Yield the variables of a file of version 4."""
    at, order = 0, "<"
    while at < len(data):
        if at + 20 > len(data):
            yield Variable("", b"", "the file ends in it")
            return
        if not at:
            order = "<" if struct.unpack("<I", data[:4])[0] < 5000 else ">"
        kind, rows, columns, imaginary, letters = struct.unpack(order + "IIIII", data[at : at + 20])
        stored, content = kind // 10 % 10, kind % 10
        if kind >= 5000 or stored >= len(_NUMBERS4) or content > 2 or letters > 256 or imaginary > 1:
            yield Variable("", b"", "it begins with a type that does not exist")
            return
        end = at + 20 + letters + rows * columns * (1 + imaginary) * _NUMBERS4[stored]
        name = bytes(data[at + 20 : at + 20 + letters]).rstrip(b"\0").decode("latin-1")
        if end > len(data):
            yield Variable(name, b"", "the file ends in it")
            return
        yield Variable(name, bytes(data[at:end])) if content < 2 else Variable(name, b"", SPARSE)
        at = end


def _unpacked(packed: memoryview, foreign: Foreign, before: int, order: str) -> tuple[memoryview, bool]:
    """Unpack an element as far as possible; also return whether it is complete."""
    unpacker = zlib.decompressobj()
    try:
        tag = unpacker.decompress(packed, 8)
        if len(tag) < 8:
            return memoryview(tag), False
        length = struct.unpack(order + "II", tag)[1]
        foreign.refuse_claim(before + length)
        rest = unpacker.decompress(unpacker.unconsumed_tail, length) if length else b""
    except zlib.error:
        return memoryview(b""), False
    return memoryview(tag + rest), len(rest) == length


def _checked(element: memoryview, order: str, whole: bool) -> Variable:
    name = ""
    try:
        end = 8 + struct.unpack(order + "II", element[:8])[1] if len(element) >= 8 else 0
        parts = parts_of(element, 8, len(element), order, to_the_end=whole)
        name = _name(element, parts)
        if not whole or end > len(element):
            return Variable(name, b"", "the file ends in it, or it is damaged")
        if kind_of(element, parts, order) in (OPAQUE, _SPARSE):
            return Variable(name, b"", _why_not(element, parts, order))
        _check(element, 8, end, order, 0)
    except DamageError as cause:
        return Variable(name, b"", str(cause))
    return Variable(name, bytes(element), order=order)


def parts_of(data: memoryview, start: int, end: int, order: str, to_the_end: bool = True) -> list[MatElement]:
    """Return the elements within an element."""
    parts: list[MatElement] = []
    while start < end:
        if start + 8 > end:
            if not to_the_end:
                return parts
            raise DamageError("its last part is cut off")
        kind, length = struct.unpack(order + "II", data[start : start + 8])
        if kind >> 16:  # a small element has its bytes in its tag
            kind, length, at, following = kind & 0xFFFF, kind >> 16, start + 4, start + 8
        else:
            at, following = start + 8, start + 8 + length + -length % 8
        if length > 4 and at == start + 4:
            raise DamageError("a part of it claims more than it holds")
        if at + length > end:
            if not to_the_end:
                return parts
            raise DamageError("a part of it claims more than it holds")
        parts.append(MatElement(kind, at, length))
        start = following
    return parts


def kind_of(data: memoryview, parts: list[MatElement], order: str) -> int:
    """Return the class of an array."""
    if not parts or parts[0].length != 8:
        raise DamageError("it does not say what it is")
    return int(struct.unpack(order + "I", data[parts[0].start : parts[0].start + 4])[0] & 0xFF)


def _name(data: memoryview, parts: list[MatElement]) -> str:
    """Return the name: the first text among the elements."""
    texts = [part for part in parts[1:4] if part.kind in (1, 2, 16)]
    return bytes(data[texts[0].start :][: texts[0].length]).decode("latin-1") if texts else ""


def _why_not(data: memoryview, parts: list[MatElement], order: str) -> str:
    """Return why a sparse array, or one that only MATLAB can open, is not read."""
    if kind_of(data, parts, order) == _SPARSE:
        return SPARSE
    texts = [bytes(data[one.start :][: one.length]).decode("latin-1") for one in parts[1:] if one.kind in (1, 2, 16)]
    return f"it is a MATLAB {texts[-1] if texts else 'object'}, which only MATLAB opens"


def _check(data: memoryview, start: int, end: int, order: str, depth: int) -> None:
    """Check that an array has as many values as it claims, and is not nested too deep.

    Raises
    ------
    DamageError
        If the check fails.
    """
    if depth > _DEEPEST:
        raise DamageError(f"it is nested more than {_DEEPEST} deep")
    if start == end:
        return  # an empty cell
    parts = parts_of(data, start, end, order)
    kind = kind_of(data, parts, order)
    inner = [part for part in parts if part.kind == MATRIX]
    if any(part.kind not in _TYPES for part in parts):
        raise DamageError("a part of it has a type that does not exist")
    if not 0 < kind <= OPAQUE:
        raise DamageError(f"it has the class {kind}, which does not exist")
    if kind not in (OPAQUE, _FUNCTION):
        _check_kinds(data, parts, order, kind, len(inner))
        _check_count(data, parts, order, kind, len(inner))
    for part in inner:
        _check(data, part.start, part.start + part.length, order, depth + 1)


def _check_kinds(data: memoryview, parts: list[MatElement], order: str, kind: int, inner: int) -> None:
    """Check that an array has the parts of its class, and no others."""
    if [part.kind for part in parts[:2]] != [6, 5] or parts[2:3] == [] or parts[2].kind not in (1, 2, 16):
        raise DamageError("it does not say what it is")
    flags = struct.unpack(order + "I", data[parts[0].start : parts[0].start + 4])[0]
    if kind in _FEWEST_PARTS:
        if len(parts) != _FEWEST_PARTS[kind] + inner:
            raise DamageError("it has other parts than its kind")
    elif kind != _SPARSE and (len(parts) != (5 if flags & _COMPLEX else 4) or inner):
        raise DamageError("it has other parts than its kind")
    elif not {part.kind for part in parts[3:]} <= (_LETTERS if kind == CHAR else _VALUES):
        raise DamageError("its values have a type that is not allowed")


def _check_count(data: memoryview, parts: list[MatElement], order: str, kind: int, inner: int) -> None:
    if len(parts) < 3 or parts[1].length % 4:
        raise DamageError("it does not say how large it is")
    dimensions = struct.unpack(f"{order}{parts[1].length // 4}i", data[parts[1].start :][: parts[1].length])
    count = 1
    for size in dimensions:
        count *= size
    if min(dimensions, default=0) < 0:
        raise DamageError("it claims a negative size")
    if kind in (STRUCT, OBJECT):
        lengths, names = parts[3 + (kind == OBJECT) :][:2] if len(parts) > 4 else (parts[0], parts[0])
        letters = struct.unpack(order + "i", data[lengths.start :][:4])[0]
        if letters <= 0 or count * (names.length // letters) != inner or (not inner and count > _SPARE):
            raise DamageError("it claims other fields than it has")
    elif kind == CELL:
        if count != inner:
            raise DamageError("it claims other cells than it has")
    elif kind != _SPARSE and count > max((part.length for part in parts), default=0) + (0 if kind == CHAR else _SPARE):
        raise DamageError("it claims more values than it has")
