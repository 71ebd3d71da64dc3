"""Rows to a NATS JetStream stream: each message is kept here until the server stored it."""

from __future__ import annotations

import itertools
import json
from typing import TYPE_CHECKING

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.brokers.nats_link import PORT, NatsLink, check_subject, stream_of
from becalm.live.brokers.remote import Remote
from becalm.live.sinks.broker import BrokerConnection, BrokerSink, Told
from becalm.live.sinks.outbox import Letter

if TYPE_CHECKING:
    from nats.aio.msg import Msg

_WINDOW = 256  # messages ahead of their acknowledgements
_HEADERS = 512  # bytes that a message's headers take at most
_ID = "Nats-Msg-Id"


class NatsSink(BrokerSink):
    """Publishes rows: `nats://HOST:PORT/STREAM?subject=clean.pump`.

    Messages are those of `BrokerSink`. A message's Nats-Msg-Id tells its first row and what it holds, so that the
    server drops one that it has. Where the server was killed, each row is in the stream once and in order. Where
    becalm was killed, rows since its last commit are sent again, perhaps in other messages.

    Options: `subject=`, which the stream must hold; those of `BrokerSink`.

    Parameters
    ----------
    address : Address
        As above.

    Raises
    ------
    UsageError
        If the address has no stream or subject, or other options.
    """

    def __init__(self, address: Address) -> None:
        address.refuse_unknown((*self.OPTIONS, "subject", "creds"))
        super().__init__(Remote.parsed(address, PORT, PORT))
        self._stream = stream_of(self._remote)
        self._subject = address.options.get("subject", "")
        if not self._subject or set(self._subject) & set("*> \t"):
            raise UsageError(f"{address} does not name one subject to publish to; add subject=clean.pump")

    def _connect(self) -> BrokerConnection:
        line = _NatsLine(self._remote, self._stream, self._subject, self._told)
        line.connect(reached=self._reached)
        try:
            check_subject(line.stream_info(self._stream, reached=self._reached), self._subject)
            if self._refusal is None:  # else an earlier message may be missing before the last
                self._outbox.arrived(line.last_id())
        except BaseException:
            line.close()
            raise
        return line


class _NatsLine(NatsLink):
    """A connection that publishes to the address's subject."""

    window = _WINDOW

    def __init__(self, remote: Remote, stream: str, subject: str, told: Told) -> None:
        super().__init__(remote)
        self._stream = stream
        self._subject = subject
        self._told = told
        self._numbers = itertools.count(1)
        self._inbox = ""
        self.largest = 0

    def connect(self, *, reached: bool) -> None:
        super().connect(reached=reached)
        self.largest = self.client.max_payload - _HEADERS
        self._inbox = self.client.new_inbox()
        self.call(self.client.subscribe(f"{self._inbox}.*", cb=self._hear))

    def last_id(self) -> str:
        """Return what the last message of the subject is called; "" where there is none, or one without a name."""
        from nats.errors import Error
        from nats.js.errors import NotFoundError

        try:
            last = self.call(self.stream_api.get_last_msg(self._stream, self._subject))
        except NotFoundError:
            return ""
        except (Error, OSError) as cause:
            raise self._remote.away(cause) from cause
        return str((last.headers or {}).get(_ID, ""))

    def post(self, letter: Letter) -> int:
        number = next(self._numbers)
        headers = {_ID: letter.name, "Nats-Expected-Stream": self._stream}
        self.start(self._sent(letter.payload, f"{self._inbox}.{number}", headers))
        return number

    async def _sent(self, payload: bytes, reply: str, headers: dict[str, str]) -> None:
        from nats.errors import Error

        try:
            await self.client.publish(self._subject, payload, reply=reply, headers=headers)
        except (Error, OSError) as cause:
            self.end(self._remote.away(cause))

    async def _hear(self, answer: Msg) -> None:
        """Hear what became of a message."""
        number = int(answer.subject.rpartition(".")[2])
        if not answer.data:  # nobody stores what is published there: the server lost JetStream, or the stream
            self.end(self._remote.away(f"nobody stores what is published to {self._subject}"))
            return
        error = json.loads(answer.data).get("error")
        if error is None:
            self._told(number, None)
            return
        said = error.get("description", error)
        if int(error.get("code", 0)) >= 500:  # its disk is full, or it has no leader now
            self._told(number, self._remote.away(f"it does not store what is published to {self._subject}: {said}"))
        else:
            self._told(number, InputError(f"NATS refuses messages of {self._subject} in {self._stream}: {said}."))
