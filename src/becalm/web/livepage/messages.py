"""Define and check the messages that a live page may send; the docstring of each says what the page requests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from becalm.web import incoming_messages
from becalm.web.incoming_messages import Number, Numbered
from becalm.web.livepage.bins import LEVELS

MOST_BINS = 1 << 12
"""Maximum number of bins in one answer."""

Level = Annotated[int, Field(ge=0, lt=LEVELS)]


class From(Numbered):
    """Send the bins of a level from number `bin` on, as they close; null starts with the next one that closes."""

    do: Literal["from"]
    level: Level
    bin: Number | None = None


class Past(Numbered):
    """Send `count` closed bins of a level, from number `first` on."""

    do: Literal["past"]
    level: Level
    first: Number
    count: Annotated[int, Field(ge=1, le=MOST_BINS)]


class TuneRequest(Numbered):
    """Change the tuning of a channel; values that are left out do not change."""

    do: Literal["turn"]
    channel: Annotated[int, Field(ge=0, le=1 << 20)]
    process_noise_density: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    noise_std: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


class UndoRequest(Numbered):
    """Undo the last change, whichever viewer made it."""

    do: Literal["undo"]


Message = From | Past | TuneRequest | UndoRequest

_ANY: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="do")])


def parse_message(content: Mapping[str, Any]) -> Message:
    """Check a message of a live page; see `incoming_messages.checked_message`."""
    return incoming_messages.checked_message(_ANY, content)
