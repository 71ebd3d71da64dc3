"""Named arrays as plain bytes, and back: a head that tells what follows, the numbers, and a check sum over both."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]

_KINDS = ("<f8", "<i8", "|i1")
_LENGTH = 4  # bytes of the head's length, and of the check sum


def packed(arrays: Arrays) -> bytes:
    """Return arrays of float64, int64 and int8 as bytes; the same arrays give the same bytes."""
    parts = [np.asarray(array, order="C") for array in arrays.values()]
    told = [[name, part.dtype.str, part.shape] for name, part in zip(arrays, parts, strict=True)]
    assert all(kind in _KINDS for _, kind, _ in told), told
    head = json.dumps(told, separators=(",", ":")).encode()
    body = b"".join([len(head).to_bytes(_LENGTH, "little"), head, *(part.tobytes() for part in parts)])
    return body + zlib.crc32(body).to_bytes(_LENGTH, "little")


def unpacked(blob: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of `packed`, in copies of their own.

    Raises
    ------
    ValueError
        If a byte is missing, or another one came.
    """
    body, check = blob[:-_LENGTH], blob[-_LENGTH:]
    if len(check) < _LENGTH or zlib.crc32(body).to_bytes(_LENGTH, "little") != check:
        raise ValueError("its check sum is not that of its bytes")
    at = _LENGTH + int.from_bytes(body[:_LENGTH], "little")
    arrays: dict[str, NDArray[Any]] = {}
    for name, kind, shape in json.loads(body[_LENGTH:at]):
        if kind not in _KINDS:
            raise ValueError(f"{kind} is no kind of number that is packed")
        count = int(np.prod(shape))
        arrays[name] = np.frombuffer(body, np.dtype(kind), count, at).reshape(shape).copy()
        at += arrays[name].nbytes
    return arrays
