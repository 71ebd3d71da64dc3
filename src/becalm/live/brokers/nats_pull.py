"""Pull the messages of a JetStream stream in order from a given number on; end the connection if one is missing."""

from __future__ import annotations

import contextlib
import json
import time
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from becalm.errors import InputError
from becalm.live.brokers.nats_link import NatsLink
from becalm.live.brokers.remote import Remote

if TYPE_CHECKING:
    from nats.aio.msg import Msg

_BUFFERED_BYTES = 32_000_000  # most bytes of requested and buffered messages, if all are as large as the largest so far
_MOST_REQUESTED = 4096  # messages; fewer if they are large
_EXPIRES_S, _HEARTBEAT_S = 30.0, 5.0  # time limit of a request, and interval of its heartbeats, in seconds
_SILENT_S = 20.0  # silence after which the server counts as away, in seconds
_INACTIVE_S = 120.0  # time without requests after which the server removes the consumer
_NANO = 1_000_000_000  # nanoseconds per second


class StreamMessage(NamedTuple):
    """A message of a stream.

    Attributes
    ----------
    number : int
        Number in the stream, from 1.
    payload : bytes
        Content of the message.
    stored_s : float
        Time when the server stored it, in seconds since 1970; the same whenever the message is read.
    arrived_s : float
        `time.monotonic()` when it arrived.
    """

    number: int
    payload: bytes
    stored_s: float
    arrived_s: float


class NatsPull:
    """Requests messages ahead of their use, up to a limit, and checks that none is missing.

    The server does not record what was read: its consumer is ephemeral, and starts at a given message.

    Parameters
    ----------
    remote : Remote
        The server.
    link : NatsLink
        The connection to it.
    """

    def __init__(self, remote: Remote, link: NatsLink) -> None:
        self._remote = remote
        self._link = link
        self._buffered: deque[StreamMessage] = deque()
        self._requested = 0  # messages requested and not received yet
        self._last = 0  # number of this consumer's last message
        self._largest = 1000  # bytes of the largest message so far
        self._last_received_s = time.monotonic()
        self._stream = self._consumer = self._inbox = ""

    def begin(self, stream: str, first: int, subject: str | None) -> None:
        """Start to request the messages of a stream.

        Parameters
        ----------
        stream : str
            Name of the stream.
        first : int
            Number of the first message.
        subject : str or None
            Subject of the messages; None for all.

        Raises
        ------
        InputError
            If the server refuses the request.
        AwayError
            If the connection is lost.
        """
        from nats.errors import Error
        from nats.js.errors import APIError

        self._stream = stream
        try:
            self._link.call(self._make_consumer(first, subject))
        except APIError as cause:
            raise InputError(f"NATS at {self._remote.host} refuses to read {stream}: {cause.description}.") from cause
        except (Error, OSError) as cause:
            raise self._remote.away(cause) from cause
        self._request()

    def take(self, timeout_s: float, at_once: int) -> list[StreamMessage]:
        """Return the next messages, at most `at_once`; [] if none arrives within `timeout_s`.

        Raises
        ------
        AwayError
            If the connection ended, a message was lost, or the server is silent.
        """
        link = self._link
        with link.changed:
            link.changed.wait_for(lambda: bool(self._buffered) or link.ended, timeout_s)
            taken = [self._buffered.popleft() for _ in range(min(len(self._buffered), at_once))]
            silent = self._requested > 0 and time.monotonic() > self._last_received_s + _SILENT_S
        if not taken:
            link.check()
            if silent:
                raise self._remote.away(f"it was silent for {_SILENT_S:g} s")
        self._request()
        return taken

    def end(self) -> None:
        """Stop, and remove the consumer."""
        if self._consumer and not self._link.ended:
            with contextlib.suppress(Exception):  # the server removes an inactive consumer by itself
                self._link.call(self._link.stream_api.delete_consumer(self._stream, self._consumer))

    async def _make_consumer(self, first: int, subject: str | None) -> None:
        from nats.js.api import AckPolicy, ConsumerConfig, DeliverPolicy

        client = self._link.client
        self._inbox = client.new_inbox()
        await client.subscribe(self._inbox, cb=self._on_message, pending_msgs_limit=-1, pending_bytes_limit=-1)
        config = ConsumerConfig(
            deliver_policy=DeliverPolicy.BY_START_SEQUENCE,
            opt_start_seq=first,
            ack_policy=AckPolicy.NONE,
            filter_subject=subject,
            inactive_threshold=_INACTIVE_S,
            mem_storage=True,
        )
        self._consumer = (await self._link.stream_api.add_consumer(self._stream, config)).name

    def _request(self) -> None:
        """Request more messages once half of the limit is free."""
        from nats.errors import Error

        with self._link.changed:
            limit = max(2, min(_MOST_REQUESTED, _BUFFERED_BYTES // self._largest))
            more = limit - self._requested - len(self._buffered)
            if more < limit / 2 or self._link.ended:
                return
            if not self._requested:
                self._last_received_s = time.monotonic()
            self._requested += more
        request = {"batch": more, "expires": int(_EXPIRES_S * _NANO), "idle_heartbeat": int(_HEARTBEAT_S * _NANO)}
        subject = f"$JS.API.CONSUMER.MSG.NEXT.{self._stream}.{self._consumer}"
        try:
            self._link.call(self._link.client.publish(subject, json.dumps(request).encode(), reply=self._inbox))
        except (Error, OSError) as cause:
            self._link.end(self._remote.away(cause))

    async def _on_message(self, message: Msg) -> None:
        """Handle a message of the stream or a status of the server, on the connection's thread."""
        link = self._link
        with link.changed:
            self._last_received_s = time.monotonic()
            if message.reply:
                self._buffer(message)
            else:
                self._handle_status(message.headers or {})
            link.changed.notify_all()

    def _buffer(self, message: Msg) -> None:
        number, consumer_number, stored_ns = _numbers_of(message.reply)
        if consumer_number != self._last + 1:
            self._link.end(self._remote.away(f"messages before {number} were lost in transit"))
            return
        self._last = consumer_number
        self._requested -= 1
        self._largest = max(self._largest, len(message.data))
        self._buffered.append(StreamMessage(number, message.data, stored_ns / _NANO, self._last_received_s))

    def _handle_status(self, headers: dict[str, str]) -> None:
        """Handle a status: 100 is a heartbeat, 408 an expired request with messages left; others end the connection."""
        status = headers.get("Status")
        if status == "100":
            return
        left = headers.get("Nats-Pending-Messages", "")
        if status == "408" and left.isdigit():
            self._requested -= int(left)
            return
        self._link.end(self._remote.away(f"it stopped: {headers.get('Description') or status}"))


def _numbers_of(reply: str) -> tuple[int, int, int]:
    """Return a message's number in the stream, its number for this consumer, and its storage time in ns."""
    words = reply.split(".")
    first = 5 if len(words) == 9 else 7  # newer servers also send their domain and account
    return int(words[first]), int(words[first + 1]), int(words[first + 2])
