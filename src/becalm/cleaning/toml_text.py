"""Read TOML that a person wrote into settings; errors are reported in a sentence."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, TypeVar

import tomlkit
from pydantic import ValidationError

from becalm.cleaning.recipe_parts import FrozenSettings
from becalm.errors import RecipeError, SensorError

Document = TypeVar("Document", bound=FrozenSettings)


class TomlKind(NamedTuple):
    """The name of a kind of file, and the error for a file that cannot be read."""

    name: str
    error: type[RecipeError | SensorError]

    def text_of(self, path: str | Path, way_out: str) -> str:
        """Return the text of a file; `way_out` is the advice at the end of an error message.

        Raises
        ------
        RecipeError or SensorError
            The error of this kind, if the file cannot be read or is not UTF-8.
        """
        try:
            return Path(path).read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as cause:
            reason = getattr(cause, "strerror", None) or "it is not UTF-8 text"
            raise self.error(f"The {self.name} {path} cannot be read: {reason}. {way_out}") from cause

    def parsed(self, model: type[Document], text: str, source: str, way_out: str) -> Document:
        """Return the settings of a text; an error message starts with `source` and ends with `way_out`.

        Raises
        ------
        RecipeError or SensorError
            The error of this kind, if the text is not TOML, or a value is missing, unknown or impossible.
        """
        try:
            return model.model_validate(tomlkit.parse(text).unwrap())
        except ValidationError as cause:
            faults = "; ".join(_faults({error["loc"]: _plain(error["msg"]) for error in cause.errors()}))
            raise self.error(f"{source} is not a valid {self.name}: {faults}. {way_out}") from cause
        except (tomlkit.exceptions.TOMLKitError, ValueError) as cause:
            raise self.error(f"{source} is not TOML ({cause}). {way_out}") from cause


def _faults(messages: dict[tuple[int | str, ...], str]) -> list[str]:
    """Return the faults with their places; without the fault of a list whose entries have faults."""
    inside = {where[:depth] for where in messages for depth in range(1, len(where))}
    named = {where: ".".join(str(part + 1) if isinstance(part, int) else part for part in where) for where in messages}
    return [f"{named[at]}: {fault}" if at else fault for at, fault in messages.items() if at not in inside]


def _plain(message: str) -> str:
    """Return the message without pydantic's prefix, and without the full stop."""
    return message.removeprefix("Value error, ").removesuffix(".")
