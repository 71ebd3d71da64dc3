"""Base class of broker sinks: rows stay in an outbox until they are acknowledged, even across reconnections."""

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
from becalm.live.sinks.outbox import LARGEST, Outbox, OutgoingMessage

_STALL_S = 20.0  # seconds without an acknowledgement after which the broker is away
_GATHER_S = 0.02  # default of the option `gather`, in seconds

ResultCallback = Callable[[int, BecalmError | None], None]
"""Called, on any thread, with the number of an acknowledged message, or with the error that refused it."""


class BrokerConnection(Protocol):
    """A connection through which messages are sent.

    Attributes
    ----------
    changed : threading.Condition
        Notified when the connection ends or a message has a result.
    window : int
        Most unacknowledged messages.
    largest : int
        Most bytes of a message.
    """

    changed: threading.Condition
    window: int
    largest: int

    @property
    def ended(self) -> bool:
        """Return whether the connection was lost."""
        ...

    def post(self, message: OutgoingMessage) -> int:
        """Send a message; return the number of its acknowledgement."""
        ...

    def check(self) -> None:
        """Raise the error that ended the connection, if any."""
        ...

    def close(self) -> None:
        """Close the connection."""
        ...


class BrokerSink(ABC):
    """A sink that publishes rows, and keeps each message until the broker has acknowledged it.

    A message contains rows of one or several outputs: `seq`, the number of its first row; `time`; and for each channel
    NAME, NAME_sigma and NAME_verdict. A reader should drop duplicate rows by `seq`, as becalm's own sources do.
    Losses are not published; they are in the journal and the log.

    Options: `format=arrow|json`, by default arrow; `gather=20ms`, the time for which rows are collected into one
    message; the options of `Remote`.

    Parameters
    ----------
    remote : Remote
        The broker.

    Attributes
    ----------
    OPTIONS : tuple of str
        Options that the addresses of all broker sinks have.
    """

    OPTIONS = ("format", "gather", *OPTIONS)

    def __init__(self, remote: Remote) -> None:
        self._remote = remote
        form = remote.address.chosen("format", FORMATS, FORMATS[0])
        self._outbox = Outbox(form, remote.address.seconds("gather", _GATHER_S))
        self._lock = threading.Lock()  # of the outbox, for the filtering thread and the commit thread
        self._connection: BrokerConnection | None = None
        self._has_connected = False
        self._acknowledged: set[int] = set()
        self._refusal: BecalmError | None = None

    @abstractmethod
    def _connect(self) -> BrokerConnection:
        """Return a new connection."""

    def open(self, head: Head) -> None:
        """Connect; unacknowledged messages are published again. Raises the errors of `Sink.open`."""
        self.close()
        self._outbox.begin(head)
        self._acknowledged = set()
        self._connection = self._connect()
        self._has_connected, self._refusal = True, None
        self._send()

    def write(self, output: Output) -> None:
        """Publish rows; if the broker is away, they are kept, and `flush` raises the error.

        Raises
        ------
        OutputError
            If a single row exceeds the broker's largest message.
        """
        with self._lock:
            self._outbox.put(output, self._largest())
        self._send()

    def flush(self) -> None:
        """Wait until the broker has acknowledged all rows written so far.

        Raises
        ------
        AwayError
            If the broker is away or silent; `open` publishes the unacknowledged messages again.
        InputError
            If the broker refuses a message.
        """
        with self._lock:
            self._outbox.seal(self._largest())
            dropped = self._outbox.dropped
            last = dropped + len(self._outbox)
        since = time.monotonic()
        while dropped < last:
            self._send()
            connection = self._connection
            if connection is None:
                raise self._remote.away("the connection was lost before")
            has_event = self._wait(connection, dropped)
            if self._refusal is not None:
                raise self._refusal
            with self._lock:
                self._outbox.drop_acknowledged(self._acknowledged)
            if self._outbox.dropped > dropped:
                dropped, since = self._outbox.dropped, time.monotonic()
            elif not has_event and time.monotonic() > since + _STALL_S:
                raise self._remote.away(f"it acknowledged nothing for {_STALL_S:g} s")
            else:
                connection.check()

    def close(self) -> None:
        """Disconnect; unacknowledged messages are kept. May be called twice."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    def _largest(self) -> int:
        """Return the largest size of a message in bytes."""
        return LARGEST if self._connection is None else self._connection.largest

    def _send(self) -> None:
        """Publish messages up to the connection's window."""
        connection = self._connection
        if connection is None or connection.ended:
            return
        with self._lock:
            self._outbox.drop_acknowledged(self._acknowledged)
            while self._outbox.in_flight < connection.window and (message := self._outbox.next()) is not None:
                self._outbox.sent(connection.post(message))

    def _wait(self, connection: BrokerConnection, dropped: int) -> bool:
        """Wait up to 1 s for an acknowledgement, a refusal or a lost connection; return whether one occurred.

        An acknowledgement that `write` saw first has left no trace but the outbox's count, which was `dropped`.
        """
        with connection.changed:
            return connection.changed.wait_for(
                lambda: bool(self._acknowledged or self._outbox.dropped > dropped or self._refusal or connection.ended),
                1.0,
            )

    def _on_result(self, number: int, refusal: BecalmError | None) -> None:
        """Record the result of a message; the connection's thread calls this."""
        connection = self._connection
        if refusal is None:
            self._acknowledged.add(number)
        else:
            self._refusal = refusal
        if connection is not None:
            with connection.changed:
                connection.changed.notify_all()
