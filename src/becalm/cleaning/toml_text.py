"""TOML that a person wrote, read into settings; what is wrong with it is said in a sentence."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, TypeVar

import tomlkit
from pydantic import ValidationError

from becalm.cleaning.recipe_parts import FrozenSettings
from becalm.errors import RecipeError, SensorError

Document = TypeVar("Document", bound=FrozenSettings)


class TomlKind(NamedTuple):
    """What a file is called, and what is raised where it is none."""

    name: str
    error: type[RecipeError | SensorError]

    def text_of(self, path: str | Path, way_out: str) -> str:
        """Return the text of a file; `way_out` ends the sentence that says why it cannot be read.

        Raises
        ------
        RecipeError or SensorError
            As this kind has it, if the file cannot be read or is not UTF-8.
        """
        try:
            return Path(path).read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as cause:
            reason = getattr(cause, "strerror", None) or "it is not UTF-8 text"
            raise self.error(f"The {self.name} {path} cannot be read: {reason}. {way_out}") from cause

    def parsed(self, model: type[Document], text: str, source: str, way_out: str) -> Document:
        """Return what a text says; `source` begins the sentence that says what is wrong, `way_out` ends it.

        Raises
        ------
        RecipeError or SensorError
            As this kind has it, if the text is not TOML, or a value is missing, unknown or impossible.
        """
        try:
            return model.model_validate(tomlkit.parse(text).unwrap())
        except ValidationError as cause:
            faults = "; ".join(_faults({error["loc"]: _words(error["msg"]) for error in cause.errors()}))
            raise self.error(f"{source} does not say what a {self.name} must: {faults}. {way_out}") from cause
        except (tomlkit.exceptions.TOMLKitError, ValueError) as cause:
            raise self.error(f"{source} is not TOML ({cause}). {way_out}") from cause


def _faults(messages: dict[tuple[int | str, ...], str]) -> list[str]:
    """Say what is wrong where; of a list that counts as empty because of what is in it, only that."""
    inside = {where[:depth] for where in messages for depth in range(1, len(where))}
    named = {where: ".".join(str(part + 1) if isinstance(part, int) else part for part in where) for where in messages}
    return [f"{named[at]}: {said}" if at else said for at, said in messages.items() if at not in inside]


def _words(message: str) -> str:
    """Return what is wrong without pydantic's heading, and without the full stop that follows all faults."""
    return message.removeprefix("Value error, ").removesuffix(".")
