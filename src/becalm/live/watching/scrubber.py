"""Remove secrets from logs, status files and the live page: passwords from the environment and in addresses."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote, quote_plus

_ENDINGS = ("PASSWORD", "TOKEN", "SECRET")
_SHORTEST = 4  # least length of a secret in characters: replacing a one-letter secret would garble every text
_HIDDEN = "***"
_IN_ADDRESS = re.compile(r"(?<=//)\S*@")  # user and password, with any characters
_NAMED = re.compile(r"(?i)((?:password|token|secret)=)[^&\s]+")  # password=... and the like in a text


class Scrubber:
    """Replaces secrets in texts and values with ***.

    Secrets are the values, of four or more characters, of environment variables whose names end in PASSWORD, TOKEN or
    SECRET, and their JSON, Python and URL encodings; the text between // and @ of an address; the text after password=,
    token= or secret=; and values with such names.

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

    def scrub_text(self, text: str) -> str:
        """Return a text without secrets."""
        if self._secrets is not None:
            text = self._secrets.sub(_HIDDEN, text)
        return _NAMED.sub(rf"\1{_HIDDEN}", _IN_ADDRESS.sub(f"{_HIDDEN}@", text))

    def scrub_value(self, value: Any) -> Any:
        """Return a value without secrets; tuples and sets become lists, NaN, Inf and other objects become text."""
        if value is None or isinstance(value, int) or (isinstance(value, float) and math.isfinite(value)):
            return value
        if isinstance(value, dict):
            return {self.scrub_text(str(key)): self.scrub_named(str(key), each) for key, each in value.items()}
        if isinstance(value, list | tuple | set | frozenset):
            return [self.scrub_value(each) for each in value]
        return self.scrub_text(str(value))

    def scrub_named(self, name: str, value: Any) -> Any:
        """Return a named value without secrets; a value with the name of a secret is replaced with ***."""
        return _HIDDEN if name.upper().endswith(_ENDINGS) else self.scrub_value(value)

    def __call__(self, _logger: Any, _method: str, event: Any) -> Any:
        """Scrub one line, as a processor of structlog."""
        return {name: self.scrub_named(name, each) for name, each in event.items()}


def _notations(secret: str) -> set[str]:
    """Return the notations in which a secret may occur in a text."""
    as_json = (json.dumps(secret)[1:-1], json.dumps(secret, ensure_ascii=False)[1:-1])
    raw_bytes = secret.encode(errors="surrogateescape")  # bytes that are not text, as os.environ stores them
    return {
        secret,
        repr(secret)[1:-1],
        ascii(secret)[1:-1],
        *as_json,
        quote(raw_bytes),
        quote(raw_bytes, safe=""),
        quote_plus(raw_bytes),
    }
