"""Rows from an MQTT broker: by QoS 1, in a session that it keeps, acknowledged when they are kept here for good."""

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
from becalm.live.position import told_by

if TYPE_CHECKING:
    from paho.mqtt.client import MQTTMessage

_AT_ONCE = 256  # messages in a block: a backlog is told in pieces
_QUEUED_BYTES = 64_000_000


class _Message(NamedTuple):
    number: int  # for its acknowledgement; 0 of QoS 0, which has none
    payload: bytes
    came_s: float  # seconds since 1970
    arrived_s: float  # time.monotonic()


class MqttSource:
    """Reads a topic: `mqtt://HOST:PORT/TOPIC`.

    A message is acknowledged once its rows are kept for good: a broker that keeps sessions gives again what was not,
    and what comes twice is left out by its numbers. Whatever the broker itself loses is known by gaps in `seq`, and
    counted; mosquitto as installed writes its store every half an hour, so kill -9 loses all that it held.
    A sender that numbers no rows gets neither: its messages may come twice, and what is lost is not known.
    Messages are read as `MessageStream` tells.

    Version 5 lets the broker send `window` messages ahead of their acknowledgements. Version 3.1.1 has no word for
    it: mosquitto then sends 20 for every commit, until its `max_inflight_messages` is raised.

    Options: `client=NAME`, by which the broker knows this session (made of the topic; two readers of one topic need
    two, or the broker drops either for the other: it is away again and again); `keep=7d`, how long the broker keeps
    the session of one who is away; `version=5|3.1.1`; `window=10000`; those of `MessageStream` and
    `Remote`.

    Parameters
    ----------
    address : Address
        As above.

    Raises
    ------
    UsageError
        If the address has no topic, a pattern of topics, or other options.
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
        self._reached = False
        self._queue: deque[_Message] = deque()
        self._queued_bytes = 0
        self._noticed: tuple[Loss, ...] = ()
        self._blocks: int | None = None  # how many had rows
        self._kept = 0  # up to which of them all is kept for good
        self._guard = threading.Lock()  # rows are read by one thread and committed by another
        self._unacknowledged: deque[tuple[int, int]] = deque()  # (number, the block that has to be kept first)

    def open(self, position: str) -> None:
        """Connect, or raise as `Source.open`, and go on with the session; what is not acknowledged comes again."""
        self.close()
        told = told_by("mqtt", position, "blocks")
        if self._blocks is None:
            self._blocks = self._kept = told.get("blocks", 0)
        self._stream.resume(told.get("rows", {}))
        self._queue.clear()
        self._queued_bytes = 0
        with self._guard:
            self._unacknowledged.clear()
        self._link = link = MqttLink(self._remote, self._session, on_message=self._came)
        link.connect(reached=self._reached)
        if (position or self._reached) and not link.remembered:
            says = f"{self._remote.host} has forgotten this client, and the messages that it held for it."
            self._noticed += (Loss(LossKind.GAP, None, says),)
        self._reached = True
        link.subscribe(self._topic)

    def read(self, timeout_s: float) -> Block | None:
        """Return the rows of the messages that came; None where none did within `timeout_s`.

        Raises
        ------
        AwayError
            If the connection ended.
        """
        link = self._link
        if link is None:
            raise self._remote.away("it is not open")
        with link.changed:
            link.changed.wait_for(lambda: self._queue or link.ended, 0.0 if self._noticed else timeout_s)
            taken = [self._queue.popleft() for _ in range(min(len(self._queue), _AT_ONCE))]
            self._queued_bytes -= sum(len(message.payload) for message in taken)
            link.changed.notify_all()
        if not taken and not self._noticed:
            link.check()
            return None
        self._stream.take_many([(message.payload, message.came_s) for message in taken])
        block = self._stream.block(extra=self._noticed)
        self._noticed = ()
        self._settle(taken, new=block is not None and len(block) > 0)
        if block is None:
            return None
        arrived_s = taken[-1].arrived_s if taken else time.monotonic()
        position = json.dumps({"blocks": self._blocks, "rows": self._stream.state})
        return replace(block, position=position, arrived_s=arrived_s)

    def committed(self, position: str) -> None:
        """Acknowledge the messages of all blocks up to `position`."""
        told = told_by("mqtt", position, "blocks")
        self._kept = max(self._kept, told.get("blocks", 0))
        self._acknowledge()

    def close(self) -> None:
        """Disconnect; the broker keeps the session."""
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _came(self, message: MQTTMessage) -> None:
        """Queue a message, on paho's thread; a full queue lets the broker wait."""
        link = self._link
        if link is None:
            return
        held = _Message(message.mid if message.qos else 0, bytes(message.payload), time.time(), time.monotonic())
        with link.changed:
            while self._queued_bytes > _QUEUED_BYTES and not link.closing:
                link.changed.wait(0.1)
            self._queue.append(held)
            self._queued_bytes += len(held.payload)
            link.changed.notify_all()

    def _settle(self, taken: list[_Message], *, new: bool) -> None:
        """Note what has to be kept before these messages are acknowledged: their rows, or, without, those before."""
        blocks = self._blocks = (self._blocks or 0) + new
        with self._guard:
            self._unacknowledged.extend((message.number, blocks) for message in taken if message.number)
        self._acknowledge()

    def _acknowledge(self) -> None:
        """Acknowledge, in order, what may be."""
        with self._guard:
            link = self._link
            while link is not None and self._unacknowledged and self._unacknowledged[0][1] <= self._kept:
                link.acknowledge(self._unacknowledged.popleft()[0])
