"""Encode the frames for a page: a text frame is JSON, a binary frame is a JSON header followed by arrays."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

UNFORESEEN = "An unexpected error occurred in becalm; its error output shows the cause."
"""Message to a page after a fault of becalm itself."""

_ALIGNED = 8  # bytes: alignment of each array, which the typed arrays of a page need
_LENGTH = struct.Struct("<I")  # length of the header, in bytes
_TYPES = {"f4": "<f4", "f8": "<f8", "u2": "<u2"}
_WIDEST = 1e38  # limit of magnitudes, so that differences fit into float32

Values = NDArray[np.float32] | NDArray[np.float64] | NDArray[np.uint16]


class Relative(NamedTuple):
    """Numbers as float32 differences from a common offset.

    Attributes
    ----------
    values : array of float32
        Differences from the offset.
    offset : float
        Number to add to each difference.
    """

    values: NDArray[np.float32]
    offset: float


def relative(values: NDArray[np.float64]) -> Relative | NDArray[np.float64]:
    """Return numbers relative to the middle of their range, in half the bytes.

    Parameters
    ----------
    values : array of float64
        Numbers; NaN and infinite values stay as they are.

    Returns
    -------
    Relative or array of float64
        The differences, or the unchanged array if float32 would overflow.
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
        Entries of the header without "arrays"; numbers that are not finite become null.
    arrays : mapping of str to array or Relative
        Arrays of float32, float64 or uint16, of any shape; they are written in row-major order.

    Raises
    ------
    TypeError
        If an array is of another type.
    """
    layout: dict[str, dict[str, Any]] = {}
    parts: list[bytes] = []
    at = 0
    for name, given in arrays.items():
        values, offset = given if isinstance(given, Relative) else (given, None)
        kind = values.dtype.kind + str(values.dtype.itemsize)
        if kind not in _TYPES:
            raise TypeError(f"{name} is {values.dtype}; a frame can contain {', '.join(_TYPES)}.")
        part = values.astype(_TYPES[kind], copy=False).tobytes()
        layout[name] = {"type": kind, "at": at, "count": values.size}
        if offset is not None:
            layout[name]["offset"] = offset
        part += bytes(-len(part) % _ALIGNED)
        parts.append(part)
        at += len(part)
    head = text({**header, "arrays": layout}).encode()
    head += b" " * (-(_LENGTH.size + len(head)) % _ALIGNED)
    return b"".join((_LENGTH.pack(len(head)), head, *parts))


def unframed(data: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a binary frame, as a page does.

    Returns
    -------
    header : dict
        Header without "arrays".
    arrays : dict of str to array
        Flat arrays; an array with an offset is float64, and contains the sums.
    """
    (length,) = _LENGTH.unpack_from(data)
    begin = _LENGTH.size + length
    header = json.loads(data[_LENGTH.size : begin])
    arrays: dict[str, NDArray[Any]] = {}
    for name, entry in header.pop("arrays").items():
        values = np.frombuffer(data, _TYPES[entry["type"]], entry["count"], begin + entry["at"])
        arrays[name] = values + np.float64(entry["offset"]) if "offset" in entry else values
    return header, arrays


def text(message: Mapping[str, Any]) -> str:
    """Return a message as JSON; numbers that are not finite become null, because browsers cannot read NaN."""
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
