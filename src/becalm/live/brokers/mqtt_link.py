"""One connection to an MQTT broker, from CONNECT to its end; a reconnection needs a new object."""

from __future__ import annotations

import ssl
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from becalm.errors import BecalmError, InputError, UsageError
from becalm.live.brokers.mqtt_session import VERSIONS, Session
from becalm.live.brokers.remote import Login, Remote, variable
from becalm.live.optional_libraries import import_optional

if TYPE_CHECKING:
    from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage
    from paho.mqtt.properties import Properties
    from paho.mqtt.reasoncodes import ReasonCode

_ANSWER_S = 10.0  # longest wait for an answer of the broker, in seconds
_KEEPALIVE_S = 20  # longest silence of the client before it pings the broker, in seconds

# reason codes of MQTT 5
_REFUSED_LOGIN = (134, 135)  # bad user or password, not authorised
_REFUSED_VERSION = 132
_TAKEN_OVER = 142


class _ClosingSocket(ssl.SSLSocket):
    """A TLS socket that closes itself if the handshake fails; paho would leave it open."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except OSError:
            self.close()
            raise


class MqttLink:
    """A connection to an MQTT broker, and paho's thread that serves it.

    Parameters
    ----------
    remote : Remote
        The broker.
    session : Session
        Client identifier, protocol version and limits.
    on_message : callable
        Called by paho's thread with each message.
    on_acknowledged : callable
        Called by paho's thread with the number of a published message, and the broker's reason for refusing it ("" if
        it was accepted).
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
        """Notified when the connection ends; the owner of the connection may also notify it of messages."""
        self.closing = False
        """True once `close` has begun; callbacks must not block then."""
        self._client: Client | None = None
        self._serving = False
        self._answered = False
        self._subscribed = False
        self._failure: BecalmError | None = None
        self.session_present = False
        """True if the broker still had this client's session."""
        self.window = 0xFFFF
        """Number of messages that the broker accepts before it has acknowledged them."""
        self.largest = 0xFFFFFFF
        """Size of the largest message that the broker accepts, in bytes."""

    def connect(self, *, reached: bool) -> None:
        """Connect, and wait for the broker's answer.

        Parameters
        ----------
        reached : bool
            True if the broker was reached before.

        Raises
        ------
        AwayError
            If the broker cannot be reached now.
        BecalmError
            If the broker refuses the connection: a wrong password, another version.
        """
        client = self._client = self._new_client()
        client.on_connect = self._handle_connect
        client.on_disconnect = self._handle_disconnect
        client.on_subscribe = self._handle_subscribe
        client.on_message = lambda _, __, message: self._on_message(message)
        client.on_publish = self._handle_publish
        try:
            client.connect(self._remote.host, self._remote.port, _KEEPALIVE_S, **self._connect_options())
        except (OSError, ValueError) as cause:
            self.close()
            raise self._remote.failed(cause, reached=reached) from cause
        client.loop_start()
        self._serving = True
        self._wait(lambda: self._answered, "it does not answer like an MQTT broker")

    def subscribe(self, topic: str) -> None:
        """Subscribe with QoS 1; raises the errors of `connect`.

        If the broker still has the session, this does not wait for the answer to the subscription: messages of the
        session may arrive before it and fill the queue. A refusal then ends the connection later.
        """
        from paho.mqtt.client import MQTTv5
        from paho.mqtt.subscribeoptions import SubscribeOptions

        client = self._open_client()
        if client.protocol == MQTTv5:
            never = SubscribeOptions.RETAIN_DO_NOT_SEND  # a retained message is not part of a stream
            client.subscribe(topic, options=SubscribeOptions(qos=1, retainHandling=never))
        else:
            client.subscribe(topic, qos=1)
        if not self.session_present:
            self._wait(lambda: self._subscribed, "it does not answer a subscription")

    def publish(self, topic: str, payload: bytes) -> int:
        """Send a message with QoS 1; return the number of its acknowledgement."""
        return int(self._open_client().publish(topic, payload, qos=1).mid)

    def acknowledge(self, number: int) -> None:
        """Acknowledge a received message."""
        client = self._client
        if client is not None:
            client.ack(number, 1)

    @property
    def ended(self) -> bool:
        """Return whether the connection was lost or refused."""
        return self._failure is not None

    def check(self) -> None:
        """Raise the error that ended the connection, if any."""
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Close the connection; may be called twice."""
        client, self._client = self._client, None
        self.closing = True
        if client is None:
            return
        if self._serving:
            client.disconnect()
            with self.changed:
                ended = self.changed.wait_for(lambda: self._failure is not None, 2.0)
            connection = client.socket()
            if not ended and connection is not None:
                connection.close()  # DISCONNECT could not be sent
            client.loop_stop()
        client.on_connect = client.on_disconnect = client.on_subscribe = client.on_message = client.on_publish = None

    def _open_client(self) -> Client:
        if self._client is None:
            raise self._remote.away("the connection is closed")
        return self._client

    def _new_client(self) -> Client:
        import_optional(f"{self._remote.address.kind}:", "paho.mqtt.client", "paho-mqtt")
        from paho.mqtt.client import Client, MQTTv5, MQTTv311
        from paho.mqtt.enums import CallbackAPIVersion

        is_version_5 = self._session.version == "5"
        client = Client(
            CallbackAPIVersion.VERSION2,
            self._session.client,
            None if is_version_5 else not self._session.kept_s,
            protocol=MQTTv5 if is_version_5 else MQTTv311,
            reconnect_on_failure=False,
            manual_ack=True,
        )
        client.max_inflight_messages = 0  # the publisher limits the messages itself
        login: Login = self._remote.login()
        if login.user is not None:
            client.username_pw_set(login.user, login.password)
        context = self._remote.tls()
        if context is not None:
            context.sslsocket_class = _ClosingSocket
            client.tls_set_context(context)
        return client

    def _connect_options(self) -> dict[str, Any]:
        """Return the options of CONNECT; version 3.1.1 has none."""
        if self._session.version != "5":
            return {}
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]  # paho's has no types
        properties.SessionExpiryInterval = int(min(self._session.kept_s, 0xFFFFFFFF))
        properties.ReceiveMaximum = self._session.window
        return {"clean_start": not self._session.kept_s, "properties": properties}

    def _wait(self, ready: Callable[[], bool], failure_text: str) -> None:
        """Wait until `ready` returns True; after 10 s or a failure, close and raise."""
        with self.changed:
            self.changed.wait_for(lambda: ready() or self._failure is not None, _ANSWER_S)
        if ready() and self._failure is None:
            return
        failure = self._failure or self._remote.away(failure_text)
        self.close()
        raise failure

    def _handle_connect(
        self, _: Client, __: object, flags: ConnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        self.session_present = bool(flags.session_present)
        self.window = int(getattr(properties, "ReceiveMaximum", self.window))
        self.largest = int(getattr(properties, "MaximumPacketSize", self.largest))
        with self.changed:
            if reason.is_failure:
                self._failure = self._refusal(reason)
            self._answered = True
            self.changed.notify_all()

    def _handle_disconnect(
        self, _: Client, __: object, flags: DisconnectFlags, reason: ReasonCode, *___: object
    ) -> None:
        failure: BecalmError = self._remote.away(f"the connection ended ({reason})")
        if flags.is_disconnect_packet_from_server and reason.value == _TAKEN_OVER:
            failure = UsageError(
                f"{self._remote.address.kind}: another client connected to {self._remote.host} with the name of this "
                f"one, {self._session.client!r}, and took over its messages; give one of them another client=NAME."
            )
        with self.changed:
            self._failure = self._failure or failure
            self.changed.notify_all()

    def _handle_subscribe(self, _: Client, __: object, ___: int, reasons: list[ReasonCode], *____: object) -> None:
        with self.changed:
            if any(reason.is_failure for reason in reasons):
                text = ", ".join(str(reason) for reason in reasons)
                self._failure = InputError(
                    f"{self._remote.host} does not let this client read {self._remote.path}: {text}."
                )
            self._subscribed = True
            self.changed.notify_all()

    def _handle_publish(self, _: Client, __: object, number: int, reason: ReasonCode, ___: object) -> None:
        self._on_acknowledged(number, str(reason) if reason.is_failure else "")

    def _refusal(self, reason: ReasonCode) -> BecalmError:
        where, address = f"{self._remote.host}:{self._remote.port}", self._remote.address
        if reason.value in _REFUSED_LOGIN:
            return InputError(
                f"{where} refuses the login ({reason}); set {variable(address, 'USER')} and "
                f"{variable(address, 'PASSWORD')}, or give a file with both by password_file=FILE."
            )
        if reason.value == _REFUSED_VERSION:
            other = VERSIONS[1 - VERSIONS.index(self._session.version)]
            return InputError(
                f"{where} does not support MQTT {self._session.version} ({reason}); type version={other}."
            )
        return self._remote.away(f"it refuses the connection ({reason})")
