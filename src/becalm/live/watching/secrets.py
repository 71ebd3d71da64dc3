"""What no log may hold: passwords of the environment, and those in addresses."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote, quote_plus

_ENDINGS = ("PASSWORD", "TOKEN", "SECRET")
_SHORTEST = 4  # letters; hiding every "a" of a text would hide nothing
_HIDDEN = "***"
_IN_ADDRESS = re.compile(r"(?<=//)\S*@")  # user and password, whatever letters they have
_TOLD = re.compile(r"(?i)(?<=password=|...token=|..secret=)[^&\s]+")


class Scrubber:
    """Replaces secrets by stars wherever they stand in a log's values.

    Secrets are the values of environment variables whose names end in PASSWORD, TOKEN or SECRET, as they are or as
    JSON, Python or a URL writes them, if they have four letters or more; what stands between // and @ of an address;
    what follows password=, token= or secret=; and values of those names.

    Parameters
    ----------
    environment : mapping of str to str
        Where to look for secrets, once.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        known = {value for name, value in environment.items() if name.upper().endswith(_ENDINGS)}
        written = {each for value in known if len(value) >= _SHORTEST for each in _writings(value)}
        longest_first = sorted(written, key=lambda text: (-len(text), text))
        self._known = re.compile("|".join(map(re.escape, longest_first))) if written else None

    def text(self, text: str) -> str:
        """Return a text without secrets."""
        if self._known is not None:
            text = self._known.sub(_HIDDEN, text)
        return _TOLD.sub(_HIDDEN, _IN_ADDRESS.sub(f"{_HIDDEN}@", text))

    def value(self, value: Any) -> Any:
        """Return a value of a log without secrets; what is neither number, text nor a table of them becomes text."""
        if value is None or isinstance(value, int) or (isinstance(value, float) and math.isfinite(value)):
            return value
        if isinstance(value, dict):
            return {self.text(str(key)): self.named(str(key), each) for key, each in value.items()}
        if isinstance(value, list | tuple | set | frozenset):
            return [self.value(each) for each in value]
        return self.text(str(value))

    def named(self, name: str, value: Any) -> Any:
        """Return a value without secrets, and none of it where its name says that it is one."""
        return _HIDDEN if name.upper().endswith(_ENDINGS) else self.value(value)

    def __call__(self, _logger: Any, _method: str, event: Any) -> Any:
        """Scrub one line, as a processor of structlog."""
        return {name: self.named(name, each) for name, each in event.items()}


def _writings(secret: str) -> set[str]:
    """Return the ways in which a secret may be written in a text."""
    as_json = (json.dumps(secret)[1:-1], json.dumps(secret, ensure_ascii=False)[1:-1])
    bare = secret.encode(errors="surrogateescape")  # as the environment holds it
    return {
        secret,
        repr(secret)[1:-1],
        ascii(secret)[1:-1],
        *as_json,
        quote(bare),
        quote(bare, safe=""),
        quote_plus(bare),
    }
