"""Parse what a page sends: one JSON object a frame, or it is refused in a sentence."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Annotated, Any, NoReturn, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from becalm.errors import UsageError

Number = Annotated[int, Field(ge=0, le=1 << 53, strict=True)]
"""Which browsers hold exactly."""

_LONGEST = 200  # characters of what came that an answer repeats

T = TypeVar("T")


class Numbered(BaseModel):
    """A message of a page; answers to it tell its number."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    number: Number


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


def number_of(said: Mapping[str, Any]) -> int | None:
    """Return a message's number, also of one that is not understood; None where it has none."""
    number = said.get("number")
    return number if type(number) is int else None  # true is an int too


def understood(messages: TypeAdapter[T], said: Mapping[str, Any]) -> T:
    """Check a message.

    Parameters
    ----------
    messages : TypeAdapter
        Those that are understood.
    said : mapping
        As `heard` returns it.

    Raises
    ------
    UsageError
        If it is none of them; the sentence says what is wrong.
    """
    try:
        return messages.validate_python(said)
    except ValidationError as cause:
        first = cause.errors(include_input=False, include_url=False, include_context=False)[0]
        names = (str(one)[:_LONGEST] for one in first["loc"])
        wrong = ": ".join(filter(None, (".".join(names), first["msg"][:_LONGEST])))
        raise UsageError(f"A page asked for what becalm does not know ({wrong}); reload it.") from cause


def _number(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _no_number(text)


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text[:20]}{'...' if len(text) > 20 else ''} is no finite number")
