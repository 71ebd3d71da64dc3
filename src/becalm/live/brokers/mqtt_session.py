"""How becalm presents itself to an MQTT broker, and what it asks for."""

from __future__ import annotations

from dataclasses import dataclass

from becalm.errors import UsageError
from becalm.live.brokers.remote import Remote

VERSIONS = ("5", "3.1.1")
PORT, TLS_PORT = 1883, 8883


@dataclass(frozen=True)
class Session:
    """How a client presents itself.

    Attributes
    ----------
    client : str
        Its id; a broker keeps a session by it.
    version : str
        Of the protocol: "5" or "3.1.1".
    kept_s : float
        How long the broker keeps the session of a client that is away; 0 keeps none.
    window : int
        How many messages the broker may send ahead of their acknowledgements; version 5 alone can tell it.
    """

    client: str
    version: str
    kept_s: float
    window: int


def topic_of(remote: Remote) -> str:
    """Return the topic that an address names.

    Raises
    ------
    UsageError
        If it names none, or several.
    """
    topic = remote.path
    if not topic or {"+", "#", "\0"} & set(topic):
        wrong = f"names {topic!r}, which is many topics" if topic else "names no topic"
        raise UsageError(
            f"{remote.address} {wrong}; a stream has one, as each has sequence numbers of its own: "
            f"{remote.address.kind}://{remote.host}/plant/pump/acceleration"
        )
    return topic
