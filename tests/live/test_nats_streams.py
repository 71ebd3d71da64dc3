"""NATS streams that are not there, are full, forget, or hold other subjects."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from becalm.errors import InputError
from becalm.live.address import Address
from becalm.live.brokers.nats_link import matches_subject
from becalm.live.protocols import AwayError, Sink
from becalm.live.sinks.nats import NatsSink
from brokered import HEAD, output
from brokers import Broker, nats_server
from pump import link_to, made, purged
from wires import NATS, both_open

source_of, sink_of = NATS.source, NATS.sink


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


def bereft(server: Broker, *others: str) -> Sink:
    """Return a sink with rows under way, whose stream was deleted; others took its subjects over."""
    made(server)
    sink = sink_of(server.port)
    sink.open(HEAD)
    with link_to(server) as link:
        link.call(link.stream_api.delete_stream("PUMP"))
        for other in others:
            link.call(link.stream_api.add_stream(name=other, subjects=["plant.*"]))
    sink.write(output(0, 3))
    return sink


def test_a_subject_that_nobody_stores_any_more_is_away(server: Broker) -> None:
    sink = bereft(server)
    with pytest.raises(AwayError, match=r"messages published to plant\.pump are not stored"):
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
    assert matches_subject(pattern, subject) is held


def test_a_subject_that_another_stream_took_over_is_told(server: Broker) -> None:
    sink = bereft(server, "VALVE")
    with pytest.raises(InputError, match=r"refuses messages of plant\.pump in PUMP"):
        sink.flush()
    sink.close()


def test_a_full_stream_is_told_and_what_it_did_not_take_is_sent_later(server: Broker) -> None:
    from nats.js.api import DiscardPolicy

    made(server, max_msgs=2, discard=DiscardPolicy.NEW)
    sink = sink_of(server.port)
    with both_open(source_of(server.port), sink) as heard:
        for row in range(0, 20, 5):
            sink.write(output(row, 5))
        with pytest.raises(AwayError, match=r"does not store.*maximum messages"):
            sink.flush()
        heard.until(lambda: len(heard.numbers) >= 10)
        purged(server)
        sink.open(HEAD)
        sink.flush()
        heard.until(lambda: len(heard.numbers) >= 20)
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
