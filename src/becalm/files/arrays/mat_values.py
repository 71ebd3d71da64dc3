"""Read values of MAT variables of version 5 from bytes that `mat_elements` has checked.

scipy is not used, because some damaged files make it end the whole process. `mat_elements` describes the format.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from becalm.files.arrays.mat_elements import (
    CELL,
    CHAR,
    MATRIX,
    OBJECT,
    STRUCT,
    DamageError,
    MatElement,
    kind_of,
    parts_of,
)

_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_CODECS = {1: "latin-1", 2: "latin-1", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_LOGICAL = 0x200


class Opaque:
    """A value that only MATLAB can open."""


def value_of(data: memoryview, start: int, end: int, order: str) -> NDArray[Any] | Opaque:
    """Return the value of an element: numbers and flags, texts, cells as objects, structs as records of objects.

    Raises
    ------
    DamageError
        If its parts do not fit together.
    """
    if start == end:
        return np.empty((0, 0))
    parts = parts_of(data, start, end, order)
    kind = kind_of(data, parts, order)
    if kind not in _CLASSES and kind not in (CELL, STRUCT, OBJECT, CHAR):
        return Opaque()
    sizes = struct.unpack(f"{order}{parts[1].length // 4}i", _bytes(data, parts[1]))
    if kind == CHAR:
        return _texts(_bytes(data, parts[3]), parts[3].kind, sizes, order)
    if kind in _CLASSES:
        return _numbers(data, parts, sizes, order)
    inner = [value_of(data, part.start, part.start + part.length, order) for part in parts if part.kind == MATRIX]
    return _cells(inner, sizes) if kind == CELL else _records(data, parts[3 + (kind == OBJECT) :], inner, sizes, order)


def _numbers(data: memoryview, parts: list[MatElement], sizes: tuple[int, ...], order: str) -> NDArray[Any]:
    flags = struct.unpack(order + "I", data[parts[0].start : parts[0].start + 4])[0]
    kind = np.dtype(_CLASSES[flags & 0xFF])
    components = []
    for part in parts[3:5]:
        stored = np.dtype(_STORED[part.kind]).newbyteorder("<" if order == "<" else ">")
        if part.length % stored.itemsize or part.length // stored.itemsize != np.prod(sizes, dtype=object):
            raise DamageError("it has another number of values than it claims")
        with np.errstate(invalid="ignore", over="ignore"):
            components.append(np.frombuffer(_bytes(data, part), stored).astype(kind).reshape(sizes, order="F"))
    if len(components) == 2:
        return components[0] + 1j * components[1]
    return components[0] != 0 if flags & _LOGICAL else components[0]


def _texts(data: bytes, kind: int, sizes: tuple[int, ...], order: str) -> NDArray[Any]:
    """Return the lines of a char matrix."""
    if kind in _CODECS:
        codec = _CODECS[kind] + ({"<": "-le", ">": "-be"}[order] if kind > 16 else "")
        letters = data.decode(codec, "replace")
    else:
        letters = data.decode("utf-16-le" if order == "<" else "utf-16-be", "replace")
    rows = sizes[0] if sizes else 0
    if not rows or not letters:
        return np.array([""])
    if rows > len(letters):
        raise DamageError("it claims more lines than it has letters")
    return np.array([letters[row::rows].rstrip(" \0") for row in range(rows)])


def _cells(inner: list[Any], sizes: tuple[int, ...]) -> NDArray[Any]:
    cells = np.empty(len(inner), object)
    cells[:] = [*inner]
    return cells.reshape(sizes, order="F")


def _records(
    data: memoryview, parts: list[MatElement], inner: list[Any], sizes: tuple[int, ...], order: str
) -> NDArray[Any]:
    """Return an array of structs from their fields, which are stored struct by struct."""
    letters = struct.unpack(order + "i", data[parts[0].start :][:4])[0]
    text = _bytes(data, parts[1])
    names = [text[at : at + letters].split(b"\0")[0].decode("latin-1") for at in range(0, len(text), letters)]
    if len(set(names)) != len(names) or not all(names):
        raise DamageError("its fields have no distinct names")
    records = np.empty(len(inner) // len(names) if names else 0, [(name, object) for name in names])
    for position, name in enumerate(names):
        for row, value in enumerate(inner[position :: len(names)]):
            records[name][row] = value
    return records


def _bytes(data: memoryview, part: MatElement) -> bytes:
    return bytes(data[part.start : part.start + part.length])
