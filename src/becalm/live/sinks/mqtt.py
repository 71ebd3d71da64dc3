"""Rows to an MQTT broker, by QoS 1: each message is kept here until the broker acknowledged it."""

from __future__ import annotations

import time
import uuid

from becalm.errors import InputError
from becalm.live.address import Address
from becalm.live.block import Head, Output
from becalm.live.encoding import FORMATS
from becalm.live.mqtt_link import PORT, TLS_PORT, VERSIONS, MqttLink, Session, topic_of
from becalm.live.remote import OPTIONS, Remote
from becalm.live.sinks.outbox import Outbox

_WINDOW = 100  # messages ahead of their acknowledgements, where the broker takes as many
_STALL_S = 20.0


class MqttSink:
    """Publishes rows: `mqtt://HOST:PORT/TOPIC?format=json`.

    A message holds the rows of an output (or a part of a large one): `seq`, the number of its first row; `time`; and
    of each channel NAME, NAME_sigma and NAME_verdict. Where the broker was away, or becalm was killed, rows may come
    twice, by the same numbers and in order: who reads drops them by `seq`, as becalm's own source does.
    What happened to the stream is not published; the journal and the log have it.

    Options: `format=arrow|json` (arrow); `version=5|3.1.1`; `client=NAME`, where the broker lets only known ones in;
    `tls=1`, `ca=FILE`, `cert=FILE`, `key=FILE`; `password_file=FILE` (user and password, a line each), else
    BECALM_MQTT_USER and BECALM_MQTT_PASSWORD of the environment.

    Parameters
    ----------
    address : Address
        As above.

    Raises
    ------
    UsageError
        If the address has no topic, or other options.
    """

    def __init__(self, address: Address) -> None:
        address.refuse_unknown(("format", "version", "client", *OPTIONS))
        self._remote = Remote.parsed(address, PORT, TLS_PORT)
        self._topic = topic_of(self._remote)
        version = address.chosen("version", VERSIONS, VERSIONS[0])
        name = address.options.get("client") or f"becalm-{uuid.uuid4().hex[:16]}"
        self._session = Session(name, version, kept_s=0.0, window=1)
        self._outbox = Outbox(address.chosen("format", FORMATS, FORMATS[0]))
        self._link: MqttLink | None = None
        self._reached = False
        self._acknowledged: set[int] = set()
        self._refusal = ""

    def open(self, head: Head) -> None:
        """Connect; what an earlier connection left without an acknowledgement is published again."""
        self.close()
        self._outbox.begin(head)
        self._acknowledged, self._refusal = set(), ""
        link = MqttLink(self._remote, self._session, on_acknowledged=self._told)
        link.connect(reached=self._reached)
        self._link, self._reached = link, True
        self._send()

    def write(self, output: Output) -> None:
        """Publish rows; where the broker is away they wait here, and `flush` tells it."""
        link = self._link
        self._outbox.put(output, link.largest - len(self._topic.encode()) - 32 if link else 0xFFFFFFF)
        self._send()

    def flush(self) -> None:
        """Wait until the broker acknowledged all.

        Raises
        ------
        AwayError
            If it went away, or is silent: `open` publishes again what it did not acknowledge.
        InputError
            If it refuses messages.
        """
        left, since = len(self._outbox), time.monotonic()
        while left:
            self._send()
            link = self._link
            if link is None:
                raise self._remote.away("it went away before")
            heard = self._listen(link)
            if self._refusal:
                raise InputError(f"{self._remote.host} refuses messages of {self._topic}: {self._refusal}.")
            self._outbox.acknowledged(self._acknowledged)
            if len(self._outbox) < left:
                left, since = len(self._outbox), time.monotonic()
            elif not heard and time.monotonic() > since + _STALL_S:
                raise self._remote.away(f"it acknowledged nothing for {_STALL_S:g} s")
            else:
                link.check()

    def close(self) -> None:
        """Disconnect; what is not acknowledged stays here."""
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _send(self) -> None:
        """Publish what may be under way."""
        link = self._link
        if link is None or link.ended:
            return
        self._outbox.acknowledged(self._acknowledged)
        while self._outbox.flying < min(_WINDOW, link.window) and (letter := self._outbox.next()) is not None:
            self._outbox.sent(link.publish(self._topic, letter.payload))

    def _listen(self, link: MqttLink) -> bool:
        """Wait a while for acknowledgements, or for the end; whether something came."""
        with link.changed:
            return link.changed.wait_for(lambda: bool(self._acknowledged or self._refusal or link.ended), 1.0)

    def _told(self, number: int, refusal: str) -> None:
        """Hear an acknowledgement, on paho's thread."""
        link = self._link
        if refusal:
            self._refusal = refusal
        self._acknowledged.add(number)
        if link is not None:
            with link.changed:
                link.changed.notify_all()
