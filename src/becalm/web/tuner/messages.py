"""Define and check the messages that a page of the tuner may send; the docstring of each says what it requests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, model_validator

from becalm.cleaning.recipes.recipe import Mode
from becalm.web import incoming_messages
from becalm.web.incoming_messages import Numbered

MOST_STRETCHES = 4000
"""Largest number of stretches of a picture; a stretch of rows is drawn as one minimum and one maximum."""

_LONGEST_NAME, _LONGEST_RECIPE = 500, 1_000_000

Channel = Annotated[int, Field(ge=0, le=1 << 20, strict=True)]
Name = Annotated[str, Field(max_length=_LONGEST_NAME, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Open(Numbered):
    """Open a file; `group` chooses one of several time axes, and `rate_hz` replaces the times in the file."""

    do: Literal["open"]
    file: Name
    group: Name | None = None
    rate_hz: Positive | None = None


class ListFiles(Numbered):
    """List the files that may be opened now."""

    do: Literal["files"]


class Look(Numbered):
    """Show a part of a channel in at most `width` stretches; null is the beginning or the end of the record."""

    do: Literal["look"]
    channel: Channel
    from_s: Finite | None = None
    to_s: Finite | None = None
    width: Annotated[int, Field(ge=1, le=MOST_STRETCHES)]


class SettingChanges(BaseModel):
    """Changes of a channel's settings; values that are left out do not change."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    choice: Name | None = None
    noise_std: Positive | None = None
    process_noise_density: NotNegative | None = None
    on: dict[Name, bool] | None = None
    unchanged: bool | None = None


class Turn(Numbered):
    """Change the settings of a channel; `final` is false while the person still drags a dial."""

    do: Literal["turn"]
    channel: Channel
    settings: SettingChanges
    final: bool = True


class SetMode(Numbered):
    """Set the mode: smoother, causal filter, or fixed lag."""

    do: Literal["mode"]
    mode: Mode
    lag_s: Positive | None = None

    @model_validator(mode="after")
    def _lag_belongs_to_lagged(self) -> SetMode:
        if (self.mode == "lagged") != (self.lag_s is not None):
            raise ValueError('lag_s and mode "lagged" belong together')
        return self


class Undo(Numbered):
    """Undo the last change."""

    do: Literal["undo"]


class Redo(Numbered):
    """Redo the change that was undone last."""

    do: Literal["redo"]


class Map(Numbered):
    """Send the map of how well each noise and density predicts readings."""

    do: Literal["map"]
    channel: Channel


class Compare(Numbered):
    """Draw a classic filter for comparison; null draws none."""

    do: Literal["compare"]
    channel: Channel
    classic: Name | None = None


class Restore(Numbered):
    """Set all filters as in a recipe."""

    do: Literal["restore"]
    recipe: Annotated[str, Field(max_length=_LONGEST_RECIPE)]


Message = Open | ListFiles | Look | Turn | SetMode | Undo | Redo | Map | Compare | Restore

_ANY: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="do")])


def parse_message(content: Mapping[str, Any]) -> Message:
    """Check a message of a tuner page; see `incoming_messages.checked_message`."""
    return incoming_messages.checked_message(_ANY, content)
