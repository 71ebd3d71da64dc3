"""What sinks of all brokers share: rows wait in an outbox until they are acknowledged, through any number of lines."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol

from becalm.errors import BecalmError
from becalm.live.block import Head, Output
from becalm.live.brokers.remote import OPTIONS, Remote
from becalm.live.messages.encoding import FORMATS
from becalm.live.sinks.outbox import LARGEST, Letter, Outbox

_STALL_S = 20.0
_GATHER_S = 0.02

Told = Callable[[int, BecalmError | None], None]
"""Hears the number of a message that was acknowledged, or why it was refused; on any thread."""


class BrokerConnection(Protocol):
    """A connection that messages are sent through."""

    changed: threading.Condition
    window: int
    largest: int

    @property
    def ended(self) -> bool:
        """Whether it ended by itself."""
        ...

    def post(self, letter: Letter) -> int:
        """Send a message; return the number that its acknowledgement will have."""
        ...

    def check(self) -> None:
        """Raise what ended the connection, if anything did."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class BrokerSink(ABC):
    """Publishes rows, and holds each until the broker acknowledged it.

    A message holds rows of one or several outputs: `seq`, the number of its first row; `time`; and of each channel
    NAME, NAME_sigma and NAME_verdict. Who reads drops rows that come twice by `seq`, as becalm's own sources do.
    What happened to the stream is not published; the journal and the log have it.

    Options: `format=arrow|json` (arrow); `gather=20ms`, for how long rows are gathered into a message; those of
    `Remote`.

    Parameters
    ----------
    remote : Remote
        The broker.

    Attributes
    ----------
    OPTIONS : tuple of str
        What the addresses of all of them understand.
    """

    OPTIONS = ("format", "gather", *OPTIONS)

    def __init__(self, remote: Remote) -> None:
        self._remote = remote
        form = remote.address.chosen("format", FORMATS, FORMATS[0])
        self._outbox = Outbox(form, remote.address.seconds("gather", _GATHER_S))
        self._line: BrokerConnection | None = None
        self._reached = False
        self._acknowledged: set[int] = set()
        self._refusal: BecalmError | None = None

    @abstractmethod
    def _connect(self) -> BrokerConnection:
        """Return a new connection."""

    def open(self, head: Head) -> None:
        """Connect, or raise as `Sink.open`; what was left without an acknowledgement is published again."""
        self.close()
        self._outbox.begin(head)
        self._acknowledged = set()
        self._line = self._connect()
        self._reached, self._refusal = True, None
        self._send()

    def write(self, output: Output) -> None:
        """Publish rows; where the broker is away they wait here, and `flush` tells it.

        Raises
        ------
        OutputError
            If the broker takes no message as large as a single row.
        """
        self._outbox.put(output, self._largest())
        self._send()

    def flush(self) -> None:
        """Wait until the broker acknowledged all.

        Raises
        ------
        AwayError
            If it went away, or is silent: `open` publishes again what it did not acknowledge.
        InputError
            If it refuses messages.
        """
        self._outbox.seal(self._largest())
        left, since = len(self._outbox), time.monotonic()
        while left:
            self._send()
            line = self._line
            if line is None:
                raise self._remote.away("it went away before")
            heard = self._listen(line)
            if self._refusal is not None:
                raise self._refusal
            self._outbox.acknowledged(self._acknowledged)
            if len(self._outbox) < left:
                left, since = len(self._outbox), time.monotonic()
            elif not heard and time.monotonic() > since + _STALL_S:
                raise self._remote.away(f"it acknowledged nothing for {_STALL_S:g} s")
            else:
                line.check()

    def close(self) -> None:
        """Disconnect; what is not acknowledged stays here. Harmless twice."""
        line, self._line = self._line, None
        if line is not None:
            line.close()

    def _largest(self) -> int:
        """Return how many bytes a message may have."""
        return LARGEST if self._line is None else self._line.largest

    def _send(self) -> None:
        """Publish what may be under way."""
        line = self._line
        if line is None or line.ended:
            return
        self._outbox.acknowledged(self._acknowledged)
        while self._outbox.flying < line.window and (letter := self._outbox.next()) is not None:
            self._outbox.sent(line.post(letter))

    def _listen(self, line: BrokerConnection) -> bool:
        """Wait a while for acknowledgements, or for the end; whether something came."""
        with line.changed:
            return line.changed.wait_for(lambda: bool(self._acknowledged or self._refusal or line.ended), 1.0)

    def _told(self, number: int, refusal: BecalmError | None) -> None:
        """Hear of a message, on the line's thread."""
        line = self._line
        if refusal is None:
            self._acknowledged.add(number)
        else:
            self._refusal = refusal
        if line is not None:
            with line.changed:
                line.changed.notify_all()
