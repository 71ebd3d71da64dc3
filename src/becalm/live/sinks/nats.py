"""Publish rows to a NATS JetStream stream; each message is kept until the server has stored it."""

from __future__ import annotations

import itertools
import json
from typing import TYPE_CHECKING

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.brokers.nats_link import PORT, NatsLink, check_subject, stream_of
from becalm.live.brokers.remote import Remote
from becalm.live.sinks.broker import BrokerConnection, BrokerSink, ResultCallback
from becalm.live.sinks.outbox import OutgoingMessage

if TYPE_CHECKING:
    from nats.aio.msg import Msg

_WINDOW = 256  # most unacknowledged messages
_HEADERS = 512  # most bytes of a message's headers
_ID = "Nats-Msg-Id"


class NatsSink(BrokerSink):
    """A sink that publishes rows to a stream: `nats://HOST:PORT/STREAM?subject=clean.pump`.

    `BrokerSink` describes the messages. A message's Nats-Msg-Id consists of the number of its first row and a hash of
    its contents, so that the server drops duplicates. If the server is killed, each row is still in the stream once
    and in order. If becalm is killed, the rows since its last commit are published again, possibly in other messages.

    Options: `subject=`, which must be a subject of the stream; the options of `BrokerSink`.

    Parameters
    ----------
    address : Address
        Address as above.

    Raises
    ------
    UsageError
        If the address has no stream or subject, or unknown options.
    """

    def __init__(self, address: Address) -> None:
        address.refuse_unknown((*self.OPTIONS, "subject", "creds"))
        super().__init__(Remote.parsed(address, PORT, PORT))
        self._stream = stream_of(self._remote)
        self._subject = address.options.get("subject", "")
        if not self._subject or set(self._subject) & set("*> \t"):
            raise UsageError(f"{address} does not name one subject to publish to; add for example subject=clean.pump")

    def _connect(self) -> BrokerConnection:
        connection = _NatsPublisher(self._remote, self._stream, self._subject, self._on_result)
        connection.connect(reached=self._has_connected)
        try:
            check_subject(connection.stream_info(self._stream, reached=self._has_connected), self._subject)
            if self._refusal is None:  # after a refusal, a message before the last one may be missing
                self._outbox.drop_through(connection.last_id())
        except BaseException:
            connection.close()
            raise
        return connection


class _NatsPublisher(NatsLink):
    """A connection that publishes to the address's subject."""

    window = _WINDOW

    def __init__(self, remote: Remote, stream: str, subject: str, on_result: ResultCallback) -> None:
        super().__init__(remote)
        self._stream = stream
        self._subject = subject
        self._on_result = on_result
        self._numbers = itertools.count(1)
        self._inbox = ""
        self.largest = 0

    def connect(self, *, reached: bool) -> None:
        super().connect(reached=reached)
        self.largest = self.client.max_payload - _HEADERS
        self._inbox = self.client.new_inbox()
        self.call(self.client.subscribe(f"{self._inbox}.*", cb=self._on_answer))

    def last_id(self) -> str:
        """Return the Nats-Msg-Id of the subject's last message; "" if there is no message, or it has none."""
        from nats.errors import Error
        from nats.js.errors import NotFoundError

        try:
            last = self.call(self.stream_api.get_last_msg(self._stream, self._subject))
        except NotFoundError:
            return ""
        except (Error, OSError) as cause:
            raise self._remote.away(cause) from cause
        return str((last.headers or {}).get(_ID, ""))

    def post(self, message: OutgoingMessage) -> int:
        number = next(self._numbers)
        headers = {_ID: message.name, "Nats-Expected-Stream": self._stream}
        self.start(self._publish(message.payload, f"{self._inbox}.{number}", headers))
        return number

    async def _publish(self, payload: bytes, reply: str, headers: dict[str, str]) -> None:
        from nats.errors import Error

        try:
            await self.client.publish(self._subject, payload, reply=reply, headers=headers)
        except (Error, OSError) as cause:
            self.end(self._remote.away(cause))

    async def _on_answer(self, answer: Msg) -> None:
        """Record the server's answer to a message."""
        number = int(answer.subject.rpartition(".")[2])
        if not answer.data:  # the server lost JetStream, or the stream
            self.end(self._remote.away(f"messages published to {self._subject} are not stored"))
            return
        error = json.loads(answer.data).get("error")
        if error is None:
            self._on_result(number, None)
            return
        reason = error.get("description", error)
        if int(error.get("code", 0)) >= 500:  # the server's disk is full, or the stream has no leader now
            self._on_result(number, self._remote.away(f"it does not store messages of {self._subject}: {reason}"))
        else:
            refusal = InputError(f"NATS refuses messages of {self._subject} in {self._stream}: {reason}.")
            self._on_result(number, refusal)
