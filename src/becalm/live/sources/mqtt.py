"""Read rows from an MQTT broker with QoS 1 in a persistent session; acknowledge them once they are committed."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from becalm.live.address import Address
from becalm.live.block import Block, Loss, LossKind
from becalm.live.brokers.mqtt_link import MqttLink
from becalm.live.brokers.mqtt_session import PORT, TLS_PORT, VERSIONS, Session, topic_of
from becalm.live.brokers.remote import OPTIONS, Remote
from becalm.live.messages.stream import MessageStream
from becalm.live.position import parse_position

if TYPE_CHECKING:
    from paho.mqtt.client import MQTTMessage

_BLOCK_MESSAGES = 256  # most messages in a block, so that a backlog is split
_QUEUED_BYTES = 64_000_000  # bytes of queued messages above which paho's thread waits


class _Message(NamedTuple):
    number: int  # message identifier for the acknowledgement; 0 for QoS 0, which has none
    payload: bytes
    received_s: float  # seconds since 1970
    arrived_s: float  # time.monotonic()


class MqttSource:
    """A source that reads a topic: `mqtt://HOST:PORT/TOPIC`.

    A message is acknowledged once its rows are committed. A broker that keeps sessions sends unacknowledged messages
    again; duplicates are recognized by the row numbers and left out. Rows that the broker itself loses are counted by
    the gaps in `seq`; mosquitto by default writes its store every 30 minutes, so kill -9 loses what it has not written.
    If the sender does not number its rows, duplicates are not left out and losses are not counted.
    `MessageStream` describes the messages.

    With version 5 the broker may send `window` messages before they are acknowledged. Version 3.1.1 cannot set this
    number: mosquitto then sends 20 messages for each commit, unless its `max_inflight_messages` is raised.

    Options: `client=NAME`, the client identifier of this session, by default made from the topic (two readers of one
    topic need two names, else the broker disconnects one of them again and again); `keep=7d`, the time for which the
    broker keeps the session while the client is away; `version=5|3.1.1`; `window=10000`; the options of `MessageStream`
    and `Remote`.

    Parameters
    ----------
    address : Address
        Address as above.

    Raises
    ------
    UsageError
        If the address has no topic, a pattern of topics, or unknown options.
    """

    OWN_OPTIONS = ("client", "keep", "version", "window")
    replays = False

    def __init__(self, address: Address) -> None:
        address.refuse_unknown((*self.OWN_OPTIONS, *MessageStream.OPTIONS, *OPTIONS))
        self._remote = Remote.parsed(address, PORT, TLS_PORT)
        self._topic = topic_of(self._remote)
        digest = hashlib.blake2b(self._topic.encode(), digest_size=6).hexdigest()
        self._session = Session(
            address.options.get("client") or f"becalm-{digest}",
            address.chosen("version", VERSIONS, VERSIONS[0]),
            max(1.0, address.seconds("keep", 7 * 86400.0)),
            int(address.number("window", 10_000, least=1, greatest=65_535)),
        )
        self._stream = MessageStream(address)
        self.rate_hz = self._stream.rate_hz
        self._link: MqttLink | None = None
        self._has_connected = False
        self._queue: deque[_Message] = deque()
        self._queued_bytes = 0
        self._pending_losses: tuple[Loss, ...] = ()
        self._blocks: int | None = None  # number of blocks with rows; None before `open`
        self._committed_blocks = 0  # number of these blocks that are committed
        self._guard = threading.Lock()  # one thread reads rows, another commits them
        self._unacknowledged: deque[tuple[int, int]] = deque()  # (message, block that must be committed before)

    def open(self, position: str) -> None:
        """Connect and continue the session; the broker sends unacknowledged messages again.

        Raises the errors of `Source.open`.
        """
        self.close()
        fields = parse_position("mqtt", position, "blocks")
        if self._blocks is None:
            self._blocks = self._committed_blocks = fields.get("blocks", 0)
        self._stream.resume(fields.get("rows", {}))
        self._queue.clear()
        self._queued_bytes = 0
        with self._guard:
            self._unacknowledged.clear()
        self._link = link = MqttLink(self._remote, self._session, on_message=self._on_message)
        link.connect(reached=self._has_connected)
        if (position or self._has_connected) and not link.session_present:
            text = f"{self._remote.host} no longer has this client's session; messages that it held for it are lost."
            self._pending_losses += (Loss(LossKind.GAP, None, text),)
        self._has_connected = True
        link.subscribe(self._topic)

    def read(self, timeout_s: float) -> Block | None:
        """Return the rows of the received messages; None if none arrives within `timeout_s`.

        Raises
        ------
        AwayError
            If the connection is lost.
        """
        link = self._link
        if link is None:
            raise self._remote.away("it is not open")
        with link.changed:
            link.changed.wait_for(lambda: self._queue or link.ended, 0.0 if self._pending_losses else timeout_s)
            taken = [self._queue.popleft() for _ in range(min(len(self._queue), _BLOCK_MESSAGES))]
            self._queued_bytes -= sum(len(message.payload) for message in taken)
            link.changed.notify_all()
        if not taken and not self._pending_losses:
            link.check()
            return None
        self._stream.take_many([(message.payload, message.received_s) for message in taken])
        block = self._stream.block(extra=self._pending_losses)
        self._pending_losses = ()
        self._acknowledge_after_commit(taken, new=block is not None and len(block) > 0)
        if block is None:
            return None
        arrived_s = taken[-1].arrived_s if taken else time.monotonic()
        position = json.dumps({"blocks": self._blocks, "rows": self._stream.state})
        return replace(block, position=position, arrived_s=arrived_s)

    def committed(self, position: str) -> None:
        """Acknowledge the messages of all blocks up to `position`."""
        self._committed_blocks = max(
            self._committed_blocks, parse_position("mqtt", position, "blocks").get("blocks", 0)
        )
        self._acknowledge()

    def close(self) -> None:
        """Disconnect; the broker keeps the session."""
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _on_message(self, message: MQTTMessage) -> None:
        """Queue a message; paho's thread calls this and waits while the queue is full."""
        link = self._link
        if link is None:
            return
        queued = _Message(message.mid if message.qos else 0, bytes(message.payload), time.time(), time.monotonic())
        with link.changed:
            while self._queued_bytes > _QUEUED_BYTES and not link.closing:
                link.changed.wait(0.1)
            self._queue.append(queued)
            self._queued_bytes += len(queued.payload)
            link.changed.notify_all()

    def _acknowledge_after_commit(self, taken: list[_Message], *, new: bool) -> None:
        """Record the block that must be committed before these messages are acknowledged.

        If the messages made a `new` block with rows, this is that block, else the block before.
        """
        blocks = self._blocks = (self._blocks or 0) + new
        with self._guard:
            self._unacknowledged.extend((message.number, blocks) for message in taken if message.number)
        self._acknowledge()

    def _acknowledge(self) -> None:
        """Acknowledge in order the messages whose rows are committed."""
        with self._guard:
            link = self._link
            while link is not None and self._unacknowledged and self._unacknowledged[0][1] <= self._committed_blocks:
                link.acknowledge(self._unacknowledged.popleft()[0])
