"""The messages of a JetStream stream, from one of them on, in order, none missing: or the connection ends."""

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

_HELD_BYTES = 32_000_000
_ASKED = 4096  # messages asked for at most; fewer where they are large
_EXPIRES_S, _HEARTBEAT_S, _SILENT_S = 30.0, 5.0, 20.0
_FORGOTTEN_S = 120.0  # after which the server forgets a consumer that asks for nothing
_NANO = 1_000_000_000


class StreamMessage(NamedTuple):
    """A message of a stream.

    Attributes
    ----------
    number : int
        In the stream, from 1.
    payload : bytes
        What it holds.
    stored_s : float
        When the server stored it, in seconds since 1970: the same at every reading.
    arrived_s : float
        `time.monotonic()` when it came.
    """

    number: int
    payload: bytes
    stored_s: float
    arrived_s: float


class NatsPull:
    """Asks for messages ahead, as many as are welcome, and checks that none is left out on the way.

    The server keeps no account of what was read: its consumer is a passing one, which begins where it is told.

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
        self._came: deque[StreamMessage] = deque()
        self._asked = 0  # and not come yet
        self._last = 0  # message of this consumer
        self._largest = 1000  # bytes of a message so far
        self._heard_s = time.monotonic()
        self._stream = self._consumer = self._inbox = ""

    def begin(self, stream: str, first: int, subject: str | None) -> None:
        """Ask for the messages of a stream.

        Parameters
        ----------
        stream : str
            Its name.
        first : int
            The first message wanted.
        subject : str or None
            Those of this subject alone.

        Raises
        ------
        InputError
            If the server will not.
        AwayError
            If it went away.
        """
        from nats.errors import Error
        from nats.js.errors import APIError

        self._stream = stream
        try:
            self._link.call(self._begun(first, subject))
        except APIError as cause:
            raise InputError(f"NATS at {self._remote.host} will not read {stream}: {cause.description}.") from cause
        except (Error, OSError) as cause:
            raise self._remote.away(cause) from cause
        self._ask()

    def take(self, timeout_s: float, at_once: int) -> list[StreamMessage]:
        """Return the next messages, at most so many; [] where none came in time.

        Raises
        ------
        AwayError
            If the connection ended, or is not whole any more.
        """
        link = self._link
        with link.changed:
            link.changed.wait_for(lambda: bool(self._came) or link.ended, timeout_s)
            taken = [self._came.popleft() for _ in range(min(len(self._came), at_once))]
            silent = self._asked > 0 and time.monotonic() > self._heard_s + _SILENT_S
        if not taken:
            link.check()
            if silent:
                raise self._remote.away(f"it was silent for {_SILENT_S:g} s")
        self._ask()
        return taken

    def end(self) -> None:
        """Ask for no more."""
        if self._consumer and not self._link.ended:
            with contextlib.suppress(Exception):  # the server forgets it by itself
                self._link.call(self._link.stream_api.delete_consumer(self._stream, self._consumer))

    async def _begun(self, first: int, subject: str | None) -> None:
        from nats.js.api import AckPolicy, ConsumerConfig, DeliverPolicy

        client = self._link.client
        self._inbox = client.new_inbox()
        await client.subscribe(self._inbox, cb=self._hear, pending_msgs_limit=-1, pending_bytes_limit=-1)
        config = ConsumerConfig(
            deliver_policy=DeliverPolicy.BY_START_SEQUENCE,
            opt_start_seq=first,
            ack_policy=AckPolicy.NONE,
            filter_subject=subject,
            inactive_threshold=_FORGOTTEN_S,
            mem_storage=True,
        )
        self._consumer = (await self._link.stream_api.add_consumer(self._stream, config)).name

    def _ask(self) -> None:
        """Ask for more messages once half of those that are welcome have come and gone."""
        with self._link.changed:
            welcome = max(2, min(_ASKED, _HELD_BYTES // self._largest))
            more = welcome - self._asked - len(self._came)
            if more < welcome / 2 or self._link.ended:
                return
            if not self._asked:
                self._heard_s = time.monotonic()
            self._asked += more
        asked = {"batch": more, "expires": int(_EXPIRES_S * _NANO), "idle_heartbeat": int(_HEARTBEAT_S * _NANO)}
        to = f"$JS.API.CONSUMER.MSG.NEXT.{self._stream}.{self._consumer}"
        try:
            self._link.call(self._link.client.publish(to, json.dumps(asked).encode(), reply=self._inbox))
        except OSError as cause:
            self._link.end(self._remote.away(cause))

    async def _hear(self, told: Msg) -> None:
        """Hear a message or a word of the server's, on the connection's thread."""
        link = self._link
        with link.changed:
            self._heard_s = time.monotonic()
            if told.reply:
                self._hold(told)
            else:
                self._mind(told.headers or {})
            link.changed.notify_all()

    def _hold(self, told: Msg) -> None:
        number, place, stored_ns = _places(told.reply)
        if place != self._last + 1:
            self._link.end(self._remote.away(f"messages got lost on the way before {number}"))
            return
        self._last = place
        self._asked -= 1
        self._largest = max(self._largest, len(told.data))
        self._came.append(StreamMessage(number, told.data, stored_ns / _NANO, self._heard_s))

    def _mind(self, told: dict[str, str]) -> None:
        """Mind what the server says: alive; this much will not come of what was asked; no more at all."""
        status = told.get("Status")
        if status == "100":
            return
        left = told.get("Nats-Pending-Messages", "")
        if status == "408" and left.isdigit():
            self._asked -= int(left)
            return
        self._link.end(self._remote.away(f"it stopped: {told.get('Description') or status}"))


def _places(reply: str) -> tuple[int, int, int]:
    """Return a message's number in the stream, its number for this consumer, and when it was stored, in ns."""
    words = reply.split(".")
    first = 5 if len(words) == 9 else 7  # newer servers tell their domain and account too
    return int(words[first]), int(words[first + 1]), int(words[first + 2])
