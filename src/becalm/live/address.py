"""How sources and sinks are named on the command line: KIND:REST?option=value&option=value."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from urllib.parse import parse_qsl

from becalm.errors import BecalmError, UsageError

_TIMES = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_TIME = re.compile(r"(?P<number>\d+\.?\d*|\.\d+)\s*(?P<unit>us|ms|s|min|h|d)")
_SECRET = re.compile(r"(?<=//)[^/@]*@")  # user and password of a URL
_ADVICE = re.compile(
    r"--(?P<name>rate|time|group|channels|stamps)( (?P<value>HZ|COLUMN|NAME|as-written|'[^']*'|\d[\w.+]*\b))?"
)


@dataclass(frozen=True)
class Address:
    """A source or sink as it was named.

    Attributes
    ----------
    kind : str
        "replay", "udp", ...
    rest : str
        What stands behind the colon: a file, a port, a URL.
    options : dict of str to str
        What stands behind the question mark.
    """

    kind: str
    rest: str
    options: dict[str, str] = field(default_factory=dict)

    @classmethod
    def parsed(cls, text: str) -> Address:
        """Take a name apart.

        Raises
        ------
        UsageError
            If there is no kind, or an option stands there twice or without a value.
        """
        kind, colon, rest = text.partition(":")
        if not colon or not kind.strip():
            raise UsageError(f"{text!r} does not say of which kind it is; write KIND:..., as udp:9000 or replay:FILE.")
        rest, question, tail = rest.partition("?")
        try:
            pairs = parse_qsl(tail, keep_blank_values=True, strict_parsing=True) if question else []
        except ValueError as cause:
            raise UsageError(f"The options of {text!r} are not name=value joined by &.") from cause
        options = dict(pairs)
        if len(options) != len(pairs):
            raise UsageError(f"{text!r} has an option twice; give it one value.")
        return cls(kind.strip().lower(), rest, options)

    def __str__(self) -> str:
        """Return the name without secrets, as logs and recipes may hold it."""
        tail = "&".join(f"{name}={value}" for name, value in self.options.items())
        return f"{self.kind}:{_SECRET.sub('', self.rest)}{'?' if tail else ''}{tail}"

    def refuse_unknown(self, known: Sequence[str]) -> None:
        """Raise a UsageError where an option is none of the known."""
        for name in self.options:
            if name not in known:
                there = f"it has {', '.join(known)}" if known else "it has none"
                raise UsageError(f"{self.kind}: has no option {name!r}; {there}.")

    def number(self, name: str, default: float, *, least: float = 0.0, greatest: float = float("inf")) -> float:
        """Return an option that is a plain number."""
        text = self.options.get(name)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not least <= value <= greatest:
            raise UsageError(f"{self.kind}: {name}={text} is no number from {least:g} to {greatest:g}.")
        return value

    def seconds(self, name: str, default: float) -> float:
        """Return an option that is a time with its unit: 50us, 20ms, 3s, 5min, 2h, 7d."""
        text = self.options.get(name)
        if text is None:
            return default
        return seconds_of(f"{self.kind}: {name}", text)

    def chosen(self, name: str, among: Sequence[str], default: str) -> str:
        """Return an option that is one of some words."""
        text = self.options.get(name, default)
        if text not in among:
            raise UsageError(f"{self.kind}: {name}={text} is none of {', '.join(among)}.")
        return text

    def names(self, name: str) -> tuple[str, ...]:
        """Return an option that is a list of names with commas; () where it is not said."""
        return tuple(part.strip() for part in self.options.get(name, "").split(",") if part.strip())


def seconds_of(what: str, text: str) -> float:
    """Read a time with its unit, as 20ms.

    Raises
    ------
    UsageError
        If it is none.
    """
    written = _TIME.fullmatch(text.strip())
    if written is None:
        raise UsageError(f"{what} {text} is no time; write a number and then {', '.join(_TIMES)}, as 20ms.")
    return float(written["number"]) * _TIMES[written["unit"]]


@contextmanager
def advising_addresses() -> Iterator[None]:
    """Where an error advises options for a file, advise those of a source: ?rate=HZ for --rate HZ."""
    try:
        yield
    except BecalmError as cause:
        said = _ADVICE.sub(lambda found: f"?{found['name']}={found['value'] or ''}", str(cause))
        if said == str(cause):
            raise
        raise type(cause)(said) from cause
