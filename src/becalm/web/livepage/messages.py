"""What a live page may ask: every word checked, and nothing else heard."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from becalm.web import incoming_messages
from becalm.web.incoming_messages import Number, Numbered
from becalm.web.livepage.bins import LEVELS

MOST_BINS = 1 << 12
"""Of one answer."""

Level = Annotated[int, Field(ge=0, lt=LEVELS)]


class From(Numbered):
    """Send bins of a level from one on, as they close; null begins with those that close next."""

    do: Literal["from"]
    level: Level
    bin: Number | None = None


class Past(Numbered):
    """Send some bins that are closed already."""

    do: Literal["past"]
    level: Level
    first: Number
    count: Annotated[int, Field(ge=1, le=MOST_BINS)]


class TuneRequest(Numbered):
    """Take another tuning for a channel; what is left out stays."""

    do: Literal["turn"]
    channel: Annotated[int, Field(ge=0, le=1 << 20)]
    process_noise_density: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    noise_std: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


class UndoRequest(Numbered):
    """Take the last turn back, whoever made it."""

    do: Literal["undo"]


Message = From | Past | TuneRequest | UndoRequest

_ANY: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="do")])


def understood(said: Mapping[str, Any]) -> Message:
    """Check what a page said, as `incoming_messages.understood` does."""
    return incoming_messages.understood(_ANY, said)
