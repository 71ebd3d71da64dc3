"""The session of an MQTT client: identifier, protocol version and limits; and the topic of an address."""

from __future__ import annotations

from dataclasses import dataclass

from becalm.errors import UsageError
from becalm.live.brokers.remote import Remote

VERSIONS = ("5", "3.1.1")
PORT, TLS_PORT = 1883, 8883


@dataclass(frozen=True)
class Session:
    """The session of an MQTT client.

    Attributes
    ----------
    client : str
        Client identifier, under which the broker stores the session.
    version : str
        Version of the protocol, "5" or "3.1.1".
    kept_s : float
        Time for which the broker keeps the session while the client is away, in seconds; 0 for no session.
    window : int
        Number of messages that the broker may send before they are acknowledged; only version 5 can set it.
    """

    client: str
    version: str
    kept_s: float
    window: int


def topic_of(remote: Remote) -> str:
    """Return the topic of an address.

    Raises
    ------
    UsageError
        If the address has no topic, or a pattern of topics.
    """
    topic = remote.path
    if not topic or {"+", "#", "\0"} & set(topic):
        wrong = f"names {topic!r}, which is many topics" if topic else "names no topic"
        raise UsageError(
            f"{remote.address} {wrong}; give one topic, because each has its own sequence numbers: "
            f"{remote.address.kind}://{remote.host}/plant/pump/acceleration"
        )
    return topic
