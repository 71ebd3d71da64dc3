"""NATS streams that are not there, are full, forget, or hold other subjects."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from becalm.errors import InputError
from becalm.live.address import Address
from becalm.live.brokers.nats_link import holds
from becalm.live.protocols import AwayError
from becalm.live.sinks.nats import NatsSink
from becalm.live.sources.nats import NatsSource
from brokered import HEAD, Heard, output
from brokers import Broker, nats_server
from pump import link_to, made


def source_of(port: int, options: str = "") -> NatsSource:
    return NatsSource(Address.parsed(f"nats://127.0.0.1:{port}/PUMP?channels=ax,ay{options}"))


def sink_of(port: int) -> NatsSink:
    return NatsSink(Address.parsed(f"nats://127.0.0.1:{port}/PUMP?gather=0s&subject=plant.pump"))


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Broker]:
    with nats_server(tmp_path / "nats") as running:
        yield running


def test_a_missing_stream_is_told(server: Broker) -> None:
    with pytest.raises(InputError, match="nats stream add PUMP --subjects"):
        source_of(server.port).open("")
    with pytest.raises(InputError, match="nats stream add PUMP --subjects"):
        sink_of(server.port).open(HEAD)


@pytest.mark.parametrize("subject", ["plant", "plant.pump.a", "else.where"])
def test_a_stream_that_does_not_hold_the_subject_is_told(server: Broker, subject: str) -> None:
    made(server)
    sink = NatsSink(Address.parsed(f"nats://127.0.0.1:{server.port}/PUMP?subject={subject}"))
    with pytest.raises(InputError, match=r"holds plant\.\*, and not"):
        sink.open(HEAD)
    with pytest.raises(InputError, match=r"holds plant\.\*, and not"):
        source_of(server.port, f"&subject={subject}").open("")


def test_a_subject_that_nobody_stores_any_more_is_away(server: Broker) -> None:
    made(server)
    sink = sink_of(server.port)
    sink.open(HEAD)
    link = link_to(server)
    link.call(link.stream_api.delete_stream("PUMP"))
    link.close()
    sink.write(output(0, 3))
    with pytest.raises(AwayError, match=r"nobody stores what is published to plant\.pump"):
        sink.flush()
    with pytest.raises(InputError, match="has no stream"):
        sink.open(HEAD)


@pytest.mark.parametrize(
    ("pattern", "subject", "held"),
    [
        ("a.b", "a.b", True),
        ("a.b", "a.c", False),
        ("a.*", "a.b", True),
        ("a.*", "a", False),
        ("*.b.*", "a.b.c", True),
        (">", "a", True),
        ("a.>", "a.b.c", True),
        ("a.>", "a", False),
        ("a.>", "b.c", False),
    ],
)
def test_patterns_of_subjects(pattern: str, subject: str, held: bool) -> None:
    assert holds(pattern, subject) is held


def test_a_subject_that_another_stream_took_over_is_told(server: Broker) -> None:
    made(server)
    sink = sink_of(server.port)
    sink.open(HEAD)
    link = link_to(server)
    link.call(link.stream_api.delete_stream("PUMP"))
    link.call(link.stream_api.add_stream(name="VALVE", subjects=["plant.*"]))
    link.close()
    sink.write(output(0, 3))
    with pytest.raises(InputError, match=r"refuses messages of plant\.pump in PUMP"):
        sink.flush()
    sink.close()


def test_a_full_stream_is_told_and_what_it_did_not_take_is_sent_later(server: Broker) -> None:
    from nats.js.api import DiscardPolicy

    made(server, max_msgs=2, discard=DiscardPolicy.NEW)
    sink, heard = sink_of(server.port), Heard(source_of(server.port))
    sink.open(HEAD)
    for row in range(0, 20, 5):
        sink.write(output(row, 5))
    with pytest.raises(AwayError, match=r"does not store.*maximum messages"):
        sink.flush()
    heard.source.open("")
    heard.until(lambda: len(heard.numbers) >= 10)
    link = link_to(server)
    link.call(link.stream_api.purge_stream("PUMP"))
    link.close()
    sink.open(HEAD)
    sink.flush()
    heard.until(lambda: len(heard.numbers) >= 20)
    heard.source.close()
    sink.close()
    assert heard.numbers == list(range(20))


@pytest.mark.parametrize("retention", ["interest", "workqueue"])
def test_a_stream_that_forgets_is_refused(server: Broker, retention: str) -> None:
    made(server, retention=retention)
    with pytest.raises(InputError, match="--retention limits"):
        source_of(server.port).open("")


def test_a_server_without_streams_is_told(tmp_path: Path) -> None:
    server = nats_server(tmp_path / "nats")
    server.command = [word for word in server.command if word != "-js"]
    with server, pytest.raises(InputError, match="nats-server -js"):
        source_of(server.port).open("")
