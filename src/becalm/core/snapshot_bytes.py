"""Convert named arrays to bytes and back: a header with names, types and shapes, the numbers, and a check sum."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]

_KINDS = ("<f8", "<i8", "|i1")
_LENGTH = 4  # number of bytes that hold the length of the header, and of those that hold the check sum


def packed(arrays: Arrays) -> bytes:
    """Return arrays of float64, int64 and int8 as bytes; equal arrays give equal bytes."""
    parts = [np.asarray(array, order="C") for array in arrays.values()]
    contents = [[name, part.dtype.str, part.shape] for name, part in zip(arrays, parts, strict=True)]
    assert all(kind in _KINDS for _, kind, _ in contents), contents
    head = json.dumps(contents, separators=(",", ":")).encode()
    body = b"".join([len(head).to_bytes(_LENGTH, "little"), head, *(part.tobytes() for part in parts)])
    return body + zlib.crc32(body).to_bytes(_LENGTH, "little")


def unpacked(blob: bytes) -> dict[str, NDArray[Any]]:
    """Return copies of the arrays that `packed` wrote.

    Raises
    ------
    ValueError
        If bytes are missing or damaged, or an array has a type that is not supported.
    """
    body, check = blob[:-_LENGTH], blob[-_LENGTH:]
    if len(check) < _LENGTH or zlib.crc32(body).to_bytes(_LENGTH, "little") != check:
        raise ValueError("the check sum does not match the bytes")
    at = _LENGTH + int.from_bytes(body[:_LENGTH], "little")
    arrays: dict[str, NDArray[Any]] = {}
    for name, kind, shape in json.loads(body[_LENGTH:at]):
        if kind not in _KINDS:
            raise ValueError(f"numbers of type {kind} are not supported")
        count = int(np.prod(shape))
        arrays[name] = np.frombuffer(body, np.dtype(kind), count, at).reshape(shape).copy()
        at += arrays[name].nbytes
    return arrays
