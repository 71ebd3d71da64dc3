"""What a page says: one JSON object a frame, or it is refused in a sentence."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, NoReturn

from becalm.errors import UsageError


def heard(frame: Mapping[str, Any]) -> dict[str, Any]:
    """Read what a WebSocket received.

    Parameters
    ----------
    frame : mapping
        An ASGI message of type "websocket.receive".

    Returns
    -------
    dict
        What its names mean is for others to check; its numbers are finite.

    Raises
    ------
    UsageError
        If it is not text, no JSON, no object, or holds a number that is none.
    """
    said = frame.get("text")
    if said is None:
        raise UsageError("A page sent bytes; it says what it wants in text, one JSON object a frame.")
    try:
        message = json.loads(said, parse_constant=_no_number, parse_float=_number)
    except (ValueError, RecursionError) as cause:  # also of integers with thousands of digits
        raise UsageError(f"A page sent what is no JSON ({str(cause)[:80]}); reload it.") from cause
    if not isinstance(message, dict):
        raise UsageError("A page sent JSON that is no object; reload it.")
    return message


def _number(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _no_number(text)


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text[:20]}{'...' if len(text) > 20 else ''} is no finite number")
