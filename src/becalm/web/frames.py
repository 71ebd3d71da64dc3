"""What goes over the wire: text frames are JSON objects; binary ones a JSON header and arrays behind it."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

UNFORESEEN = "Something went wrong in becalm that nobody foresaw; its error output says what."
"""What a page is told where becalm has a fault."""

_ALIGNED = 8  # bytes: a page lays typed arrays over a frame, which need that
_LENGTH = struct.Struct("<I")
_TYPES = {"f4": "<f4", "f8": "<f8", "u2": "<u2"}
_WIDEST = 1e38  # of what float32 still holds, with room for a difference

Values = NDArray[np.float32] | NDArray[np.float64] | NDArray[np.uint16]


class Relative(NamedTuple):
    """Numbers as differences from one of them, so that float32 keeps what a picture shows.

    Attributes
    ----------
    values : array of float32
        The differences.
    offset : float
        What is added to each of them.
    """

    values: NDArray[np.float32]
    offset: float


def relative(values: NDArray[np.float64]) -> Relative | NDArray[np.float64]:
    """Return numbers relative to the middle of their range, in half the bytes.

    Parameters
    ----------
    values : array of float64
        NaN, and what is infinite, stays so.

    Returns
    -------
    Relative or array of float64
        As they came where float32 would overflow.
    """
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return Relative(values.astype(np.float32), 0.0)
    low, high = float(finite.min()), float(finite.max())
    if not max(-low, high) < _WIDEST:
        return values
    offset = (low + high) / 2
    return Relative((values - offset).astype(np.float32), offset)


def frame(header: Mapping[str, Any], arrays: Mapping[str, Values | Relative]) -> bytes:
    """Return a binary frame.

    Parameters
    ----------
    header : mapping
        What stands in the header beside "arrays"; what is not finite becomes null.
    arrays : mapping of str to array or Relative
        float32, float64 or uint16, of any shape, told row by row.

    Raises
    ------
    TypeError
        If an array is of another type.
    """
    told: dict[str, dict[str, Any]] = {}
    parts: list[bytes] = []
    at = 0
    for name, given in arrays.items():
        values, offset = given if isinstance(given, Relative) else (given, None)
        kind = values.dtype.kind + str(values.dtype.itemsize)
        if kind not in _TYPES:
            raise TypeError(f"{name} is {values.dtype}; a frame holds {', '.join(_TYPES)}.")
        part = values.astype(_TYPES[kind], copy=False).tobytes()
        told[name] = {"type": kind, "at": at, "count": values.size}
        if offset is not None:
            told[name]["offset"] = offset
        part += bytes(-len(part) % _ALIGNED)
        parts.append(part)
        at += len(part)
    head = text({**header, "arrays": told}).encode()
    head += b" " * (-(_LENGTH.size + len(head)) % _ALIGNED)
    return b"".join((_LENGTH.pack(len(head)), head, *parts))


def unframed(data: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a binary frame, as a page does.

    Returns
    -------
    header : dict
        Without "arrays".
    arrays : dict of str to array
        With their offsets added, then in float64.
    """
    (length,) = _LENGTH.unpack_from(data)
    begin = _LENGTH.size + length
    header = json.loads(data[_LENGTH.size : begin])
    arrays: dict[str, NDArray[Any]] = {}
    for name, told in header.pop("arrays").items():
        values = np.frombuffer(data, _TYPES[told["type"]], told["count"], begin + told["at"])
        arrays[name] = values + np.float64(told["offset"]) if "offset" in told else values
    return header, arrays


def text(message: Mapping[str, Any]) -> str:
    """Return a message as JSON, in which what is not finite is null: browsers read no NaN."""
    try:
        return json.dumps(message, allow_nan=False, separators=(",", ":"))
    except ValueError:
        return json.dumps(_finite(message), allow_nan=False, separators=(",", ":"))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return value
