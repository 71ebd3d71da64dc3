"""What a live page may ask: every word checked, and nothing else heard."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from becalm.errors import UsageError
from becalm.web.livepage.bins import LEVELS

MOST_BINS = 1 << 12
"""Of one answer."""

Number = Annotated[int, Field(ge=0, le=1 << 53)]
Level = Annotated[int, Field(ge=0, lt=LEVELS)]


class _Message(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    number: Number


class From(_Message):
    """Send bins of a level from one on, as they close; null begins with those that close next."""

    do: Literal["from"]
    level: Level
    bin: Number | None = None


class Past(_Message):
    """Send some bins that are closed already."""

    do: Literal["past"]
    level: Level
    first: Number
    count: Annotated[int, Field(ge=1, le=MOST_BINS)]


class Turn(_Message):
    """Take another tuning for a channel; what is left out stays."""

    do: Literal["turn"]
    channel: Annotated[int, Field(ge=0, le=1 << 20)]
    process_noise_density: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    noise_std: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


class Undo(_Message):
    """Take the last turn back, whoever made it."""

    do: Literal["undo"]


Message = From | Past | Turn | Undo

_ANY: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="do")])


def understood(said: Mapping[str, Any]) -> Message:
    """Read a message of a page.

    Raises
    ------
    UsageError
        If it is none; the sentence says what is wrong.
    """
    try:
        return _ANY.validate_python(said)
    except ValidationError as cause:
        first = cause.errors(include_input=False, include_url=False, include_context=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise UsageError(f"A page asked for what no live page does ({place}: {first['msg']}); reload it.") from cause
