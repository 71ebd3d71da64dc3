"""One connection to an MQTT broker, from CONNECT to its end; whoever wants another makes another."""

from __future__ import annotations

import ssl
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from becalm.errors import BecalmError, InputError, UsageError
from becalm.live.brokers.mqtt_session import VERSIONS, Session
from becalm.live.brokers.remote import Login, Remote, variable
from becalm.live.optional_libraries import wanted

if TYPE_CHECKING:
    from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage
    from paho.mqtt.properties import Properties
    from paho.mqtt.reasoncodes import ReasonCode

_ANSWER_S = 10.0
_KEEPALIVE_S = 20
_REFUSED_LOGIN = (134, 135)  # bad user or password, not authorised
_REFUSED_VERSION = 132
_TAKEN_OVER = 142


class _ClosingSocket(ssl.SSLSocket):
    """Closes itself where no privacy is agreed on; paho would leave it open."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except OSError:
            self.close()
            raise


class MqttLink:
    """A connection, and a thread of paho's that serves it.

    Parameters
    ----------
    remote : Remote
        The broker.
    session : Session
        Who connects.
    on_message : callable
        Called by that thread with each message.
    on_acknowledged : callable
        Called by that thread with the number of a message that the broker took, and why it did not ("" where it did).
    """

    def __init__(
        self,
        remote: Remote,
        session: Session,
        on_message: Callable[[MQTTMessage], None] = lambda _: None,
        on_acknowledged: Callable[[int, str], None] = lambda _, __: None,
    ) -> None:
        self._remote = remote
        self._session = session
        self._on_message = on_message
        self._on_acknowledged = on_acknowledged
        self.changed = threading.Condition()
        """Told when the connection ends; those who wait for messages may share it."""
        self.closing = False
        """Whether it is being closed: then nobody may wait on its thread."""
        self._client: Client | None = None
        self._serving = False
        self._answered = False
        self._subscribed = False
        self._failure: BecalmError | None = None
        self.remembered = False
        """Whether the broker knew this client's session."""
        self.window = 0xFFFF
        """How many messages the broker takes ahead of its acknowledgements."""
        self.largest = 0xFFFFFFF
        """Bytes of the largest message that the broker takes."""

    def connect(self, *, reached: bool) -> None:
        """Connect, and wait for the broker's word.

        Parameters
        ----------
        reached : bool
            Whether the broker was ever reached before.

        Raises
        ------
        AwayError
            If it cannot be reached now.
        BecalmError
            If it refuses: a wrong password, another version.
        """
        client = self._client = self._made()
        client.on_connect = self._connected
        client.on_disconnect = self._disconnected
        client.on_subscribe = self._granted
        client.on_message = lambda _, __, message: self._on_message(message)
        client.on_publish = self._acknowledged
        try:
            client.connect(self._remote.host, self._remote.port, _KEEPALIVE_S, **self._asks())
        except (OSError, ValueError) as cause:
            self.close()
            raise self._remote.failed(cause, reached=reached) from cause
        client.loop_start()
        self._serving = True
        self._wait(lambda: self._answered, "it does not answer as an MQTT broker does")

    def subscribe(self, topic: str) -> None:
        """Subscribe by QoS 1; raises as `connect` does.

        Where the broker remembers the session, messages come before its answer, perhaps more than there is room for:
        it is not waited for then, and a refusal ends the connection.
        """
        from paho.mqtt.client import MQTTv5
        from paho.mqtt.subscribeoptions import SubscribeOptions

        client = self._there()
        if client.protocol == MQTTv5:
            never = SubscribeOptions.RETAIN_DO_NOT_SEND  # a retained message is no part of a stream
            client.subscribe(topic, options=SubscribeOptions(qos=1, retainHandling=never))
        else:
            client.subscribe(topic, qos=1)
        if not self.remembered:
            self._wait(lambda: self._subscribed, "it does not answer a subscription")

    def publish(self, topic: str, payload: bytes) -> int:
        """Hand a message over to be sent by QoS 1, and return the number that its acknowledgement will have."""
        return int(self._there().publish(topic, payload, qos=1).mid)

    def acknowledge(self, number: int) -> None:
        """Tell the broker that a message is kept."""
        client = self._client
        if client is not None:
            client.ack(number, 1)

    @property
    def ended(self) -> bool:
        """Whether the connection ended by itself."""
        return self._failure is not None

    def check(self) -> None:
        """Raise what ended the connection, if anything did."""
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """End the connection; harmless twice."""
        client, self._client = self._client, None
        self.closing = True
        if client is None:
            return
        if self._serving:
            client.disconnect()
            with self.changed:
                ended = self.changed.wait_for(lambda: self._failure is not None, 2.0)
            wire = client.socket()
            if not ended and wire is not None:
                wire.close()  # it does not even take a farewell
            client.loop_stop()
        client.on_connect = client.on_disconnect = client.on_subscribe = client.on_message = client.on_publish = None

    def _there(self) -> Client:
        if self._client is None:
            raise self._remote.away("the connection is closed")
        return self._client

    def _made(self) -> Client:
        wanted(f"{self._remote.address.kind}:", "paho.mqtt.client", "paho-mqtt")
        from paho.mqtt.client import Client, MQTTv5, MQTTv311
        from paho.mqtt.enums import CallbackAPIVersion

        modern = self._session.version == "5"
        client = Client(
            CallbackAPIVersion.VERSION2,
            self._session.client,
            None if modern else not self._session.kept_s,
            protocol=MQTTv5 if modern else MQTTv311,
            reconnect_on_failure=False,
            manual_ack=True,
        )
        client.max_inflight_messages = 0  # whoever publishes keeps the window
        login: Login = self._remote.login()
        if login.user is not None:
            client.username_pw_set(login.user, login.password)
        context = self._remote.tls()
        if context is not None:
            context.sslsocket_class = _ClosingSocket
            client.tls_set_context(context)
        return client

    def _asks(self) -> dict[str, Any]:
        """Return what CONNECT asks for; only version 5 has words for it."""
        if self._session.version != "5":
            return {}
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        asks = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]  # paho's own has no types
        asks.SessionExpiryInterval = int(min(self._session.kept_s, 0xFFFFFFFF))
        asks.ReceiveMaximum = self._session.window
        return {"clean_start": not self._session.kept_s, "properties": asks}

    def _wait(self, ready: Callable[[], bool], else_: str) -> None:
        """Wait for an answer; without one, close and raise."""
        with self.changed:
            self.changed.wait_for(lambda: ready() or self._failure is not None, _ANSWER_S)
        if ready() and self._failure is None:
            return
        failure = self._failure or self._remote.away(else_)
        self.close()
        raise failure

    def _connected(
        self, _: Client, __: object, flags: ConnectFlags, reason: ReasonCode, told: Properties | None
    ) -> None:
        self.remembered = bool(flags.session_present)
        self.window = int(getattr(told, "ReceiveMaximum", self.window))
        self.largest = int(getattr(told, "MaximumPacketSize", self.largest))
        with self.changed:
            if reason.is_failure:
                self._failure = self._refused(reason)
            self._answered = True
            self.changed.notify_all()

    def _disconnected(self, _: Client, __: object, flags: DisconnectFlags, reason: ReasonCode, *___: object) -> None:
        failure: BecalmError = self._remote.away(f"the connection ended ({reason})")
        if flags.is_disconnect_packet_from_server and reason.value == _TAKEN_OVER:
            failure = UsageError(
                f"{self._remote.address.kind}: another client came to {self._remote.host} by the name of this one, "
                f"{self._session.client!r}, and took its messages over; give one of them another by client=NAME."
            )
        with self.changed:
            self._failure = self._failure or failure
            self.changed.notify_all()

    def _granted(self, _: Client, __: object, ___: int, reasons: list[ReasonCode], *____: object) -> None:
        with self.changed:
            if any(reason.is_failure for reason in reasons):
                said = ", ".join(str(reason) for reason in reasons)
                self._failure = InputError(
                    f"{self._remote.host} does not let this client read {self._remote.path}: {said}."
                )
            self._subscribed = True
            self.changed.notify_all()

    def _acknowledged(self, _: Client, __: object, number: int, reason: ReasonCode, ___: object) -> None:
        self._on_acknowledged(number, str(reason) if reason.is_failure else "")

    def _refused(self, reason: ReasonCode) -> BecalmError:
        where, address = f"{self._remote.host}:{self._remote.port}", self._remote.address
        if reason.value in _REFUSED_LOGIN:
            return InputError(
                f"{where} refuses who comes ({reason}); set {variable(address, 'USER')} and "
                f"{variable(address, 'PASSWORD')}, or name a file of both by password_file=FILE."
            )
        if reason.value == _REFUSED_VERSION:
            other = VERSIONS[1 - VERSIONS.index(self._session.version)]
            return InputError(f"{where} does not speak MQTT {self._session.version} ({reason}); type version={other}.")
        return self._remote.away(f"it refuses ({reason})")
