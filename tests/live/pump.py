"""The stream PUMP of a real NATS server: made, looked at, filled."""

from __future__ import annotations

from typing import Any

from becalm.live.address import Address
from becalm.live.brokers.nats_link import NatsLink
from becalm.live.brokers.remote import Remote
from brokers import Broker


def link_to(server: Broker, options: str = "", host: str = "127.0.0.1") -> NatsLink:
    """Return a connection of the test's own."""
    link = NatsLink(Remote.parsed(Address.parsed(f"nats://{host}:{server.port}/PUMP?a=b{options}"), 4222, 4222))
    link.connect(reached=False)
    return link


def made(server: Broker, options: str = "", host: str = "127.0.0.1", **more: Any) -> None:
    """Make the stream, of all subjects plant.*, anew where it was."""
    link = link_to(server, options, host)
    if any(info.config.name == "PUMP" for info in link.call(link.stream_api.streams_info())):
        link.call(link.stream_api.delete_stream("PUMP"))
    link.call(link.stream_api.add_stream(name="PUMP", subjects=["plant.*"], **more))
    link.close()


def stored(server: Broker) -> int:
    """Return how many messages the stream has."""
    link = link_to(server)
    count = link.stream_info("PUMP", reached=True).state.messages
    link.close()
    return int(count)


def sent(server: Broker, payloads: list[bytes], subject: str = "plant.pump") -> None:
    """Publish messages."""
    link = link_to(server)
    for payload in payloads:
        link.call(link.stream_api.publish(subject, payload))
    link.close()
