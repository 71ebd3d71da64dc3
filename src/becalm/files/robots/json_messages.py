"""Decode JSON messages: numbers by dotted names, and stamps."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

_BEYOND = 1 << 1023  # whole numbers that no float holds
_LONGEST = 64  # longest list that becomes columns
_DEEPEST = 16  # levels of nesting that become columns
_SECOND = 1_000_000_000  # in nanoseconds
_STAMPS = (("header", "stamp"), ("stamp",), ("timestamp",))  # where a message may have its stamp
_FRACTIONS = ("nanosec", "nsec", "nsecs", "nanos")  # names of the nanoseconds of a stamp


class JsonDecoder:
    """A decoder of JSON messages, with the same interface as `RosDecoder`.

    Attributes
    ----------
    units : mapping of str to str
        Empty, because JSON messages have no units.
    left_out : set of str
        Names of texts, of numbers that no float holds, of lists too long for columns, and of what is nested too deeply.
    """

    def __init__(self) -> None:
        self.units: Mapping[str, str] = {}
        self.left_out: set[str] = set()

    def __call__(self, data: bytes) -> tuple[int | None, Iterator[tuple[str, float]]]:
        """Return the stamp of a message in nanoseconds, or None, and its numbers with their names.

        Raises
        ------
        ValueError
            If the message is not a JSON object.
        """
        message = json.loads(data)
        if not isinstance(message, dict):
            raise ValueError("a message is not a JSON object")
        return _stamp(message), self._numbers(message, "", 0)

    def _numbers(self, value: Any, name: str, depth: int) -> Iterator[tuple[str, float]]:
        if isinstance(value, (bool, float)) or (isinstance(value, int) and abs(value) < _BEYOND):
            yield name, value
        elif isinstance(value, dict) and depth < _DEEPEST:
            for key, inner in value.items():
                yield from self._numbers(inner, f"{name}.{key}" if name else str(key), depth + 1)
        elif isinstance(value, list) and depth < _DEEPEST and len(value) <= _LONGEST:
            for place, inner in enumerate(value):
                yield from self._numbers(inner, f"{name}_{place}", depth + 1)
        elif value is not None:
            self.left_out.add(name)


def _stamp(message: dict[str, Any]) -> int | None:
    """Return a message's stamp, as ROS or Foxglove write it, in nanoseconds, and remove it; None if there is none."""
    for *outer, last in _STAMPS:
        held: Any = message
        for key in outer:
            held = held.get(key) if isinstance(held, dict) else None
        stamp = held.get(last) if isinstance(held, dict) else None
        if not isinstance(stamp, dict):
            continue
        seconds, fraction = stamp.get("sec"), next((stamp[key] for key in _FRACTIONS if key in stamp), None)
        if type(seconds) is int and type(fraction) is int:
            del held[last]
            return seconds * _SECOND + fraction
    return None
