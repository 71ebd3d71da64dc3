"""The stream PUMP of a real NATS server: made, looked at, filled."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from becalm.live.address import Address
from becalm.live.brokers.nats_link import NatsLink
from becalm.live.brokers.remote import Remote
from brokers import Broker


@contextmanager
def link_to(server: Broker, options: str = "", host: str = "127.0.0.1") -> Iterator[NatsLink]:
    """Open a connection of the test's own."""
    link = NatsLink(Remote.parsed(Address.parsed(f"nats://{host}:{server.port}/PUMP?a=b{options}"), 4222, 4222))
    link.connect(reached=False)
    try:
        yield link
    finally:
        link.close()


def made(server: Broker, options: str = "", host: str = "127.0.0.1", **more: Any) -> None:
    """Make the stream, of all subjects plant.*, anew where it was."""
    with link_to(server, options, host) as link:
        if any(info.config.name == "PUMP" for info in link.call(link.stream_api.streams_info())):
            link.call(link.stream_api.delete_stream("PUMP"))
        link.call(link.stream_api.add_stream(name="PUMP", subjects=["plant.*"], **more))


def purged(server: Broker, below: int | None = None) -> None:
    """Delete the messages of the stream, or those before one of them."""
    with link_to(server) as link:
        link.call(link.stream_api.purge_stream("PUMP", seq=below))


def stored(server: Broker) -> int:
    """Return how many messages the stream has."""
    with link_to(server) as link:
        return int(link.stream_info("PUMP", reached=True).state.messages)


def sent(server: Broker, payloads: list[bytes], subject: str = "plant.pump") -> None:
    """Publish messages."""
    with link_to(server) as link:
        for payload in payloads:
            link.call(link.stream_api.publish(subject, payload))
