"""Remove secrets from log lines: passwords in environment variables and in addresses."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote, quote_plus

_ENDINGS = ("PASSWORD", "TOKEN", "SECRET")
_SHORTEST = 4  # characters; replacing a one-letter secret would garble every text
_HIDDEN = "***"
_IN_ADDRESS = re.compile(r"(?<=//)\S*@")  # user and password, with any characters
_NAMED = re.compile(r"(?i)(?<=password=|...token=|..secret=)[^&\s]+")


class Scrubber:
    """Replaces secrets in the values of a log by stars.

    These are secrets: the values of environment variables whose names end in PASSWORD, TOKEN or SECRET, with four
    characters or more, also in the notations of JSON, Python and URLs; the text between // and @ of an address; the
    text after password=, token= or secret=; and log values with such names.

    Parameters
    ----------
    environment : mapping of str to str
        Environment variables; they are read once.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        secrets = {value for name, value in environment.items() if name.upper().endswith(_ENDINGS)}
        notations = {each for value in secrets if len(value) >= _SHORTEST for each in _notations(value)}
        longest_first = sorted(notations, key=lambda text: (-len(text), text))
        self._secrets = re.compile("|".join(map(re.escape, longest_first))) if notations else None

    def text(self, text: str) -> str:
        """Return a text without secrets."""
        if self._secrets is not None:
            text = self._secrets.sub(_HIDDEN, text)
        return _NAMED.sub(_HIDDEN, _IN_ADDRESS.sub(f"{_HIDDEN}@", text))

    def value(self, value: Any) -> Any:
        """Return a log value without secrets; an object other than a number, text, dict or list becomes text."""
        if value is None or isinstance(value, int) or (isinstance(value, float) and math.isfinite(value)):
            return value
        if isinstance(value, dict):
            return {self.text(str(key)): self.named(str(key), each) for key, each in value.items()}
        if isinstance(value, list | tuple | set | frozenset):
            return [self.value(each) for each in value]
        return self.text(str(value))

    def named(self, name: str, value: Any) -> Any:
        """Return a named value without secrets; a value with the name of a secret is replaced by stars."""
        return _HIDDEN if name.upper().endswith(_ENDINGS) else self.value(value)

    def __call__(self, _logger: Any, _method: str, event: Any) -> Any:
        """Scrub one line, as a processor of structlog."""
        return {name: self.named(name, each) for name, each in event.items()}


def _notations(secret: str) -> set[str]:
    """Return the notations in which a secret may occur in a text."""
    as_json = (json.dumps(secret)[1:-1], json.dumps(secret, ensure_ascii=False)[1:-1])
    bare = secret.encode(errors="surrogateescape")  # as in the environment
    return {
        secret,
        repr(secret)[1:-1],
        ascii(secret)[1:-1],
        *as_json,
        quote(bare),
        quote(bare, safe=""),
        quote_plus(bare),
    }
