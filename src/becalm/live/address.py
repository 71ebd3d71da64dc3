"""Parse the addresses of sources and sinks: KIND:REST?option=value&option=value."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import isfinite
from urllib.parse import parse_qsl

from becalm.errors import BecalmError, UsageError

_TIMES = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_TIME = re.compile(r"(?P<number>\d+\.?\d*|\.\d+)\s*(?P<unit>us|ms|s|min|h|d)")
_SECRET = re.compile(r"(?<=//)\S*@")  # user and password of a URL, with any characters
_ADVICE = re.compile(  # command-line options in error messages
    r"--(?P<name>rate|time|group|channels|stamps)( (?P<value>HZ|COLUMN|NAME|as-written|'[^']*'|\d[\w.+]*\b))?"
)


@dataclass(frozen=True)
class Address:
    """The parsed address of a source or sink.

    Attributes
    ----------
    kind : str
        "replay", "udp", ...
    rest : str
        Text between the colon and the question mark: a file, a port, a URL.
    options : dict of str to str
        Options after the question mark.
    """

    kind: str
    rest: str
    options: dict[str, str] = field(default_factory=dict)

    @classmethod
    def parsed(cls, text: str) -> Address:
        """Parse an address.

        Raises
        ------
        UsageError
            If there is no kind, or an option occurs twice or has no value.
        """
        kind, colon, rest = text.partition(":")
        if not colon or not kind.strip():
            raise UsageError(f"{text!r} has no kind; write KIND:..., for example udp:9000 or replay:FILE.")
        rest, question, tail = rest.partition("?")
        try:
            pairs = parse_qsl(tail, keep_blank_values=True, strict_parsing=True) if question else []
        except ValueError as cause:
            raise UsageError(
                f"The options of {text!r} cannot be parsed; write name=value, joined by & if there are several."
            ) from cause
        options = dict(pairs)
        if len(options) != len(pairs):
            raise UsageError(f"{text!r} has an option twice; give it one value.")
        return cls(kind.strip().lower(), rest, options)

    def __str__(self) -> str:
        """Return the address without the user and password of a URL, for logs and recipes."""
        tail = "&".join(f"{name}={value}" for name, value in self.options.items())
        return f"{self.kind}:{_SECRET.sub('', self.rest)}{'?' if tail else ''}{tail}"

    def refuse_unknown(self, known: Sequence[str]) -> None:
        """Raise a UsageError if an option is not in `known`."""
        for name in self.options:
            if name not in known:
                options = f"its options are {', '.join(known)}" if known else "it has no options"
                raise UsageError(f"{self.kind}: has no option {name!r}; {options}.")

    def number(self, name: str, default: float, *, least: float = 0.0, greatest: float = float("inf")) -> float:
        """Return a numeric option; raise a UsageError if it is not a number from `least` to `greatest`."""
        text = self.options.get(name)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not (least <= value <= greatest and isfinite(value)):
            raise UsageError(f"{self.kind}: {name}={text} is not a number from {least:g} to {greatest:g}.")
        return value

    def seconds(self, name: str, default: float) -> float:
        """Return an option such as 20ms, 5min or 7d in seconds; raise a UsageError if it is not a time with a unit."""
        text = self.options.get(name)
        if text is None:
            return default
        return seconds_of(f"{self.kind}: {name}", text)

    def chosen(self, name: str, among: Sequence[str], default: str) -> str:
        """Return a text option; raise a UsageError if its value is not in `among`."""
        text = self.options.get(name, default)
        if text not in among:
            raise UsageError(f"{self.kind}: {name}={text} is not one of {', '.join(among)}.")
        return text

    def names(self, name: str) -> tuple[str, ...]:
        """Return an option that is a comma-separated list of names; () if it is absent.

        Raises
        ------
        UsageError
            If it has a name twice.
        """
        names = tuple(part.strip() for part in self.options.get(name, "").split(",") if part.strip())
        twice = next((one for one in names if names.count(one) > 1), None)
        if twice is not None:
            raise UsageError(f"{self.kind}: {name}= has {twice!r} twice; give each of them another name.")
        return names


def seconds_of(what: str, text: str) -> float:
    """Parse a time with unit, such as 50us, 20ms, 3s, 5min, 2h or 7d; return it in seconds.

    Parameters
    ----------
    what : str
        Name of the option, for the error message.
    text : str
        The time.

    Raises
    ------
    UsageError
        If the text is not a time.
    """
    written = _TIME.fullmatch(text.strip())
    if written is None:
        raise UsageError(f"{what} {text} is not a time; write a number with a unit ({', '.join(_TIMES)}), as 20ms.")
    return float(written["number"]) * _TIMES[written["unit"]]


@contextmanager
def advising_addresses() -> Iterator[None]:
    """Rewrite command-line options in the messages of errors as address options: --rate HZ becomes ?rate=HZ."""
    try:
        yield
    except BecalmError as cause:
        message = _ADVICE.sub(lambda match: f"?{match['name']}={match['value'] or ''}", str(cause))
        if message == str(cause):
            raise
        raise type(cause)(message) from cause
