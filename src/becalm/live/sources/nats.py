"""Rows from a NATS JetStream stream: durable, so that a stream that was killed goes on with exactly the same rows."""

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
from becalm.live.position import told_by

if TYPE_CHECKING:
    from nats.js.api import StreamInfo

_AT_ONCE = 256  # messages in a block: a backlog is told in pieces


class NatsSource:
    """Reads a stream: `nats://HOST:PORT/STREAM?subject=plant.pump`.

    The position is the number of the last message whose rows were told, so that reading goes on after it whatever
    was killed here or there: the server is acknowledged nothing. The stream keeps its messages by limits (not by
    interest, nor as a work queue), best in files. Rows without stamps have the time when the server stored them, which
    is the same at every reading. Messages that were deleted before they were read are told as missing.
    Messages are read as `MessageStream` tells.

    Options: `subject=`, where the stream has several (each is a stream of rows with numbers of its own);
    `start=first|now`, where a new stream begins (first: with all that it holds); those of `MessageStream` and
    `Remote`.

    Parameters
    ----------
    address : Address
        As above.

    Raises
    ------
    UsageError
        If the address has no stream, or other options.
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
        self._reached = False
        self._created = ""
        self._last = 0
        self._began: int | None = None  # the first message of a stream that has no position yet
        self._noticed: tuple[Loss, ...] = ()

    def open(self, position: str) -> None:
        """Connect, or raise as `Source.open`, and go on with the message after `position`."""
        self.close()
        told = told_by("nats", position, "message")
        self._link = link = NatsLink(self._remote)
        link.connect(reached=self._reached)
        info = link.stream_info(self._name, reached=self._reached)
        self._reached = True
        if info.config.retention not in (None, "limits"):
            raise InputError(
                f"The stream {self._name} forgets messages once they are read (retention {info.config.retention}), and "
                f"nothing could be read again after a kill; make it anew by --retention limits."
            )
        if self._subject is not None:
            check_subject(info, self._subject)
        self._created = str(info.created)
        first = self._first(told, info)
        self._last = first - 1
        self._stream.resume(told.get("rows", {}))
        self._pull = NatsPull(self._remote, link)
        self._pull.begin(self._name, first, self._subject)

    def read(self, timeout_s: float) -> Block | None:
        """Return the rows of the messages that came; None where none did within `timeout_s`.

        Raises
        ------
        AwayError
            If the connection ended.
        """
        if self._pull is None:
            raise self._remote.away("it is not open")
        taken = self._pull.take(0.0 if self._noticed else timeout_s, _AT_ONCE)
        if taken:
            self._stream.take_many([(message.payload, message.stored_s) for message in taken])
            self._last = taken[-1].number
        noticed, self._noticed = self._noticed, ()
        block = self._stream.block(extra=noticed)
        if block is None:
            return None
        position = json.dumps({"message": self._last, "created": self._created, "rows": self._stream.state})
        return replace(block, position=position, arrived_s=taken[-1].arrived_s if taken else time.monotonic())

    def committed(self, position: str) -> None:
        """Need not hear: the stream keeps its messages."""

    def close(self) -> None:
        """Disconnect; harmless twice."""
        pull, self._pull = self._pull, None
        link, self._link = self._link, None
        if pull is not None:
            pull.end()
        if link is not None:
            link.close()

    def _first(self, told: dict[str, Any], info: StreamInfo) -> int:
        """Return the first message to read, and notice where it is not the one after the last that was read."""
        begins, ends = max(1, info.state.first_seq), info.state.last_seq
        if not told:
            if self._began is None:
                self._began = begins if self._start == "first" else ends + 1
            return max(self._began, begins)
        after = int(told["message"]) + 1
        if told.get("created") != self._created:
            says = f"The stream {self._name} was made anew since message {after - 1}; it is read from its beginning."
            self._noticed += (Loss(LossKind.GAP, None, says),)
            return begins
        if after > ends + 1:
            says = f"The stream {self._name} lost its messages {ends + 1} to {after - 1}, which had been read."
            self._noticed += (Loss(LossKind.GAP, None, says),)
            return ends + 1
        if after < begins:
            says = f"Messages {after} to {begins - 1} of the stream {self._name} were deleted before they were read."
            self._noticed += (Loss(LossKind.MISSING, None, says),)
        return max(after, begins)
