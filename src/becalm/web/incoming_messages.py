"""Parse the messages of a page: each frame is one JSON object, and anything else raises an error."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Annotated, Any, NoReturn, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from becalm.errors import UsageError

Number = Annotated[int, Field(ge=0, le=1 << 53, strict=True)]
"""An integer that a browser can hold exactly."""

_LONGEST = 200  # limit of the characters of a page that each part of an error message repeats

T = TypeVar("T")


class Numbered(BaseModel):
    """A message of a page; an answer to it repeats its number."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    number: Number


def parse_frame(frame: Mapping[str, Any]) -> dict[str, Any]:
    """Parse a frame that a WebSocket has received.

    Parameters
    ----------
    frame : mapping
        An ASGI message of type "websocket.receive".

    Returns
    -------
    dict
        The JSON object. All its numbers are finite; its keys are not checked yet.

    Raises
    ------
    UsageError
        If the frame is not text, not JSON or not an object, or contains NaN or an infinite number.
    """
    content = frame.get("text")
    if content is None:
        raise UsageError("A page sent bytes; a message must be text, one JSON object in each frame.")
    try:
        message = json.loads(content, parse_constant=_no_number, parse_float=_number)
    except (ValueError, RecursionError) as cause:  # ValueError also for integers with thousands of digits
        raise UsageError(f"A page sent text that is not JSON ({str(cause)[:80]}); reload it.") from cause
    if not isinstance(message, dict):
        raise UsageError("A page sent JSON that is not an object; reload it.")
    return message


def number_of(content: Mapping[str, Any]) -> int | None:
    """Return the number of a message that is not checked yet; None if it has no number."""
    number = content.get("number")
    return number if type(number) is int else None  # a bool would be an instance of int too


def checked_message(messages: TypeAdapter[T], content: Mapping[str, Any]) -> T:
    """Check a message and return it as an object of its type.

    Parameters
    ----------
    messages : TypeAdapter
        Types of the allowed messages.
    content : mapping
        JSON object from `parse_frame`.

    Raises
    ------
    UsageError
        If the object is not one of the allowed messages.
    """
    try:
        return messages.validate_python(content)
    except ValidationError as cause:
        first = cause.errors(include_input=False, include_url=False, include_context=False)[0]
        names = (str(one)[:_LONGEST] for one in first["loc"])
        wrong = ": ".join(filter(None, (".".join(names), first["msg"][:_LONGEST])))
        raise UsageError(f"A page sent a message that becalm does not know ({wrong}); reload it.") from cause


def _number(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _no_number(text)


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text[:20]}{'...' if len(text) > 20 else ''} is not a finite number")
