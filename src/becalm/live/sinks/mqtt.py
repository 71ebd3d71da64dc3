"""Publish rows to an MQTT broker with QoS 1; each message is kept until the broker has acknowledged it."""

from __future__ import annotations

import uuid

from becalm.errors import InputError
from becalm.live.address import Address
from becalm.live.brokers.mqtt_link import MqttLink
from becalm.live.brokers.mqtt_session import PORT, TLS_PORT, VERSIONS, Session, topic_of
from becalm.live.brokers.remote import Remote
from becalm.live.sinks.broker import BrokerConnection, BrokerSink, ResultCallback
from becalm.live.sinks.outbox import OutgoingMessage

_WINDOW = 100  # most unacknowledged messages; fewer if the broker's limit is lower


class MqttSink(BrokerSink):
    """A sink that publishes rows to a topic: `mqtt://HOST:PORT/TOPIC?format=json`.

    `BrokerSink` describes the messages. After the broker was away, or becalm was killed, rows may be published twice:
    with the same numbers, and in order.

    Options: `version=5|3.1.1`; `client=NAME`, if the broker accepts only certain clients; the options of `BrokerSink`.

    Parameters
    ----------
    address : Address
        Address as above.

    Raises
    ------
    UsageError
        If the address has no topic, or unknown options.
    """

    def __init__(self, address: Address) -> None:
        address.refuse_unknown((*self.OPTIONS, "version", "client"))
        super().__init__(Remote.parsed(address, PORT, TLS_PORT))
        self._topic = topic_of(self._remote)
        name = address.options.get("client") or f"becalm-{uuid.uuid4().hex[:16]}"
        self._session = Session(name, address.chosen("version", VERSIONS, VERSIONS[0]), kept_s=0.0, window=1)

    def _connect(self) -> BrokerConnection:
        connection = _MqttPublisher(self._remote, self._session, self._on_result)
        connection.connect(reached=self._has_connected)
        return connection


class _MqttPublisher(MqttLink):
    """A connection that publishes to the address's topic."""

    def __init__(self, remote: Remote, session: Session, on_result: ResultCallback) -> None:
        super().__init__(remote, session, on_acknowledged=self._on_answer)
        self._on_result = on_result
        self._topic = topic_of(remote)

    def connect(self, *, reached: bool) -> None:
        super().connect(reached=reached)
        self.window = min(self.window, _WINDOW)
        self.largest -= len(self._topic.encode()) + 32  # the broker limits packets, which also hold topic and header

    def post(self, message: OutgoingMessage) -> int:
        return self.publish(self._topic, message.payload)

    def _on_answer(self, number: int, refusal: str) -> None:
        error = InputError(f"The broker refuses messages of {self._topic}: {refusal}.") if refusal else None
        self._on_result(number, error)
