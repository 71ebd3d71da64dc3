"""Read rows from a NATS JetStream stream, which stores them, so that a killed stream resumes without loss."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from becalm.errors import InputError
from becalm.live.address import Address
from becalm.live.block import Block, Loss, LossKind
from becalm.live.brokers.nats_link import PORT, NatsLink, check_subject, stream_of
from becalm.live.brokers.nats_pull import NatsPull
from becalm.live.brokers.remote import OPTIONS, Remote
from becalm.live.messages.stream import MessageStream
from becalm.live.position import parse_position

if TYPE_CHECKING:
    from nats.js.api import StreamInfo

_BLOCK_MESSAGES = 256  # most messages in a block, so that a backlog is split


class NatsSource:
    """A source that reads a stream: `nats://HOST:PORT/STREAM?subject=plant.pump`.

    The position is the number of the last message whose rows were returned. Reading continues after this message,
    even if becalm or the server was killed; messages are not acknowledged. The stream must have the retention policy
    `limits` (not `interest` or `workqueue`), preferably with file storage. Rows without stamps get the time at which
    the server stored them, which is the same whenever they are read. Messages that were deleted before they were read
    are reported as missing. `MessageStream` describes the messages.

    Options: `subject=`, if the stream has several subjects (each is a separate stream of numbered rows);
    `start=first|now`, the start of a new stream (first: the oldest message that the server stores); the options of
    `MessageStream` and `Remote`.

    Parameters
    ----------
    address : Address
        Address as above.

    Raises
    ------
    UsageError
        If the address has no stream, or unknown options.
    """

    OWN_OPTIONS = ("subject", "start")
    replays = True

    def __init__(self, address: Address) -> None:
        address.refuse_unknown((*self.OWN_OPTIONS, "creds", *MessageStream.OPTIONS, *OPTIONS))
        self._remote = Remote.parsed(address, PORT, PORT)
        self._name = stream_of(self._remote)
        self._subject = address.options.get("subject")
        self._start = address.chosen("start", ("first", "now"), "first")
        self._stream = MessageStream(address)
        self.rate_hz = self._stream.rate_hz
        self._link: NatsLink | None = None
        self._pull: NatsPull | None = None
        self._has_connected = False
        self._created = ""
        self._last = 0
        self._began: int | None = None  # number of the first message to read while there is no position
        self._pending_losses: tuple[Loss, ...] = ()

    def open(self, position: str) -> None:
        """Connect and continue with the message after `position`; raises the errors of `Source.open`."""
        self.close()
        fields = parse_position("nats", position, "message")
        self._link = link = NatsLink(self._remote)
        link.connect(reached=self._has_connected)
        info = link.stream_info(self._name, reached=self._has_connected)
        self._has_connected = True
        if info.config.retention not in (None, "limits"):
            raise InputError(
                f"The stream {self._name} deletes messages once they are read (retention {info.config.retention}), so "
                f"they could not be read again after a crash; create it again with --retention limits."
            )
        if self._subject is not None:
            check_subject(info, self._subject)
        self._created = str(info.created)
        first = self._first_message(fields, info)
        self._last = first - 1
        self._stream.resume(fields.get("rows", {}))
        self._pull = NatsPull(self._remote, link)
        self._pull.begin(self._name, first, self._subject)

    def read(self, timeout_s: float) -> Block | None:
        """Return the rows of the received messages; None if none arrives within `timeout_s`.

        Raises
        ------
        AwayError
            If the connection is lost.
        """
        if self._pull is None:
            raise self._remote.away("it is not open")
        taken = self._pull.take(0.0 if self._pending_losses else timeout_s, _BLOCK_MESSAGES)
        if taken:
            self._stream.take_many([(message.payload, message.stored_s) for message in taken])
            self._last = taken[-1].number
        losses, self._pending_losses = self._pending_losses, ()
        block = self._stream.block(extra=losses)
        if block is None:
            return None
        position = json.dumps({"message": self._last, "created": self._created, "rows": self._stream.state})
        return replace(block, position=position, arrived_s=taken[-1].arrived_s if taken else time.monotonic())

    def committed(self, position: str) -> None:
        """Do nothing: the server keeps its messages."""

    def close(self) -> None:
        """Disconnect; may be called twice."""
        pull, self._pull = self._pull, None
        link, self._link = self._link, None
        if pull is not None:
            pull.end()
        if link is not None:
            link.close()

    def _first_message(self, fields: dict[str, Any], info: StreamInfo) -> int:
        """Return the number of the first message to read; record a loss if it does not follow the last one read."""
        begins, ends = max(1, info.state.first_seq), info.state.last_seq
        if not fields:
            if self._began is None:
                self._began = begins if self._start == "first" else ends + 1
            return max(self._began, begins)
        after = int(fields["message"]) + 1
        if fields.get("created") != self._created:
            text = f"The stream {self._name} was created again since message {after - 1}; it is read from its start."
            self._pending_losses += (Loss(LossKind.GAP, None, text),)
            return begins
        if after > ends + 1:
            text = f"The stream {self._name} lost its messages {ends + 1} to {after - 1}, which had been read."
            self._pending_losses += (Loss(LossKind.GAP, None, text),)
            return ends + 1
        if after < begins:
            text = f"Messages {after} to {begins - 1} of the stream {self._name} were deleted before they were read."
            self._pending_losses += (Loss(LossKind.MISSING, None, text),)
        return max(after, begins)
