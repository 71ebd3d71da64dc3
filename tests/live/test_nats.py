"""NATS JetStream through a real server: nothing is lost and nothing comes twice, whoever is killed."""

from __future__ import annotations

import json
import random
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from becalm.live.block import LossKind
from becalm.live.protocols import Sink, Source
from becalm.live.sinks.nats import NatsSink, _NatsPublisher
from brokered import HEAD, Heard, among_garbage, flushed, message, output
from brokers import Broker, nats_server
from pump import made, purged, sent, stored
from wires import NATS, both_open, carried, heard_from


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Broker]:
    with nats_server(tmp_path / "nats") as running:
        made(running)
        yield running


def source_of(server: Broker, options: str = "") -> Source:
    return NATS.source(server.port, f"&subject=plant.pump{options}")


def sink_of(server: Broker, options: str = "") -> Sink:
    return NATS.sink(server.port, options)


@pytest.mark.parametrize("form", ["arrow", "json"])
def test_rows_go_through(server: Broker, form: str) -> None:
    heard = carried(source_of(server), sink_of(server, f"&format={form}"), 5000, at_once=10)
    assert heard.numbers == list(range(5000))
    assert heard.losses == []
    assert heard.blocks[0].names == ("ax", "ay")
    assert heard.blocks[0].units == ("m/s^2", "g")


def test_a_reader_goes_on_at_any_position(server: Broker) -> None:
    sent(server, [message(7 * k, 7) for k in range(60)])
    heard = heard_from(source_of(server), 420)
    rng = random.Random(5)
    sent(server, [message(7 * k, 7) for k in range(60, 80)])
    for block in rng.sample(heard.blocks, min(5, len(heard.blocks))):
        after = int(block.values[-1, 0]) + 1
        again = heard_from(source_of(server), 560 - after, block.position)
        assert again.numbers == list(range(after, 560))
        assert again.losses == []


def test_a_killed_server_loses_nothing(server: Broker) -> None:
    sink, rng = sink_of(server), random.Random(3)
    with both_open(source_of(server), sink) as heard:
        for turn in range(6):
            stop = rng.randrange(100)
            for place in range(100):
                sink.write(output(turn * 500 + place * 5, 5))
                if place == stop:
                    server.kill()
                    server.start()
            flushed(sink)
            heard.until(lambda turn=turn: len(heard.numbers) >= turn * 500 + 250)  # type: ignore[misc]
        heard.until(lambda: len(heard.numbers) >= 3000)
    assert heard.numbers == list(range(3000))
    assert heard.losses == []
    assert heard.returns > 0
    assert stored(server) == 600


def test_what_was_stored_and_not_acknowledged_is_not_stored_twice(server: Broker) -> None:
    made(server, duplicate_window=0.1)  # so that the server itself soon knows of nothing
    sink = sink_of(server)
    assert isinstance(sink, NatsSink)
    with both_open(source_of(server), sink) as heard:
        assert isinstance(sink._connection, _NatsPublisher)
        sink._connection._on_result = lambda *_: None  # the acknowledgements are lost
        sink.write(output(0, 5))
        sink.write(output(5, 5))
        heard.until(lambda: len(heard.numbers) >= 10)
        sink.close()
        sink.write(output(10, 5))
        time.sleep(0.5)
        sink.open(HEAD)
        sink.flush()
        heard.until(lambda: len(heard.numbers) >= 15)
    assert heard.numbers == list(range(15))
    assert heard.losses == []


def test_rows_without_stamps_have_the_same_ones_at_every_reading(server: Broker) -> None:
    sent(server, [json.dumps({"seq": k, "ax": k, "ay": 0}).encode() for k in range(20)])
    times = []
    for _ in range(2):
        heard = heard_from(source_of(server), 20)
        times.append([stamp for block in heard.blocks for stamp in block.time_s])
    assert times[0] == times[1]
    assert times[0] == sorted(times[0])


def test_what_was_deleted_unread_is_missing(server: Broker) -> None:
    sent(server, [message(5 * k, 5) for k in range(10)])
    heard = heard_from(source_of(server), 50)
    sent(server, [message(50 + 5 * k, 5) for k in range(10)])
    purged(server, below=16)
    again = heard_from(source_of(server), 25, heard.position)
    assert again.numbers == list(range(75, 100))
    assert "Messages 11 to 15" in next(loss.says for loss in again.losses)
    assert again.count(LossKind.MISSING) == 25  # and by the rows' own numbers


def test_a_stream_that_was_made_anew_is_told(server: Broker) -> None:
    sent(server, [message(0, 5)])
    heard = heard_from(source_of(server), 5)
    made(server, description="anew")
    sent(server, [message(5, 5)])
    heard.source.open(heard.position)
    heard.until(lambda: len(heard.numbers) >= 10)
    heard.source.close()
    assert heard.numbers == list(range(10))
    assert [loss.kind for loss in heard.losses] == [LossKind.GAP]
    assert "created again" in heard.losses[0].says


def test_a_stream_may_begin_now(server: Broker) -> None:
    sent(server, [message(0, 5)])
    heard = Heard(source_of(server, "&start=now"))
    heard.source.open("")
    heard.source.close()
    sent(server, [b"other"], "plant.valve")
    sent(server, [message(5, 5)])
    heard.source.open("")  # now was then
    heard.until(lambda: len(heard.numbers) >= 5)
    heard.source.close()
    assert heard.numbers == list(range(5, 10))
    assert heard.losses == []


def test_garbage_is_counted_and_passed(server: Broker) -> None:
    sent(server, among_garbage())
    heard_from(source_of(server), 10).assert_garbage_was_counted()


def test_a_large_output_is_sent_in_parts(server: Broker) -> None:
    heard = carried(source_of(server), sink_of(server), 100_000, at_once=100_000)
    assert heard.numbers == list(range(100_000))
