"""MQTT through a real mosquitto: rows through it, what it gives twice, and what it loses."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from becalm.errors import BecalmError
from becalm.live.block import Loss, LossKind
from becalm.live.brokers import mqtt_link
from becalm.live.protocols import AwayError, Sink, Source
from becalm.live.sinks import broker as broker_sink
from becalm.live.sources import mqtt as mqtt_source
from brokered import HEAD, Heard, flushed, output
from brokers import DEADLINE_S, Broker, mosquitto, nats_as_mqtt
from wires import MQTT, both_open, carried, heard_from


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with mosquitto(tmp_path / "broker") as running:
        yield running


def source_of(broker: Broker, options: str = "") -> Source:
    return MQTT.source(broker.port, options)


def sink_of(broker: Broker, options: str = "") -> Sink:
    return MQTT.sink(broker.port, options)


def assert_only_repeated(losses: list[Loss], acknowledged: int) -> None:
    """Check that nothing befell rows but that some, of those that had been acknowledged, were given again.

    mosquitto reads one packet of a connection each turn, so that a new connection may overtake the last
    acknowledgements of the one before: then it gives their rows again, which are left out and told.
    """
    assert {loss.kind for loss in losses} <= {LossKind.REPEATED}
    assert sum(loss.rows or 0 for loss in losses) <= acknowledged


@pytest.mark.parametrize("version", ["5", "3.1.1"])
@pytest.mark.parametrize("form", ["arrow", "json"])
def test_rows_go_through(broker: Broker, version: str, form: str) -> None:
    ends = source_of(broker, f"&version={version}"), sink_of(broker, f"&format={form}&version={version}")
    heard = carried(*ends, 1000, at_once=10)
    assert heard.numbers == list(range(1000))
    assert heard.losses == []
    assert heard.blocks[0].names == ("ax", "ay")
    assert heard.blocks[0].units == ("m/s^2", "g")
    assert heard.blocks[-1].time_s[-1] == 9.99


def test_what_was_not_kept_comes_again(broker: Broker) -> None:
    sink = sink_of(broker)
    with both_open(source_of(broker), sink) as first:
        for row in range(0, 100, 10):
            sink.write(output(row, 10))
            sink.flush()
            first.until(lambda row=row: len(first.numbers) >= row + 10, commit=False)  # type: ignore[misc]
        kept = first.blocks[3].position
        first.source.committed(kept)
    again = heard_from(source_of(broker), 60, kept)
    assert again.numbers == list(range(40, 100))
    assert_only_repeated(again.losses, 40)


def test_what_comes_twice_is_left_out_and_acknowledged(broker: Broker) -> None:
    sink = sink_of(broker)
    with both_open(source_of(broker), sink) as first:
        for row in range(0, 100, 10):
            sink.write(output(row, 10))
        sink.flush()
        first.until(lambda: len(first.numbers) == 100, commit=False)
        first.source.close()
        again = Heard(source_of(broker))  # it was killed after it kept all, before the broker heard of it
        with closing(again.source):
            again.source.open(first.position)
            again.until(lambda: again.count(LossKind.REPEATED) == 100, commit=False)
        assert again.numbers == []
        sink.write(output(100, 1))
        sink.flush()
    end = time.monotonic() + DEADLINE_S
    while (later := heard_from(source_of(broker), 1, first.position, commit=False)).losses:
        assert_only_repeated(later.losses, 100)
        assert time.monotonic() < end, f"the broker heard no acknowledgements: {later.losses}"
        time.sleep(0.05)
    assert later.numbers == [100]


def test_a_reader_that_was_away_gets_what_was_sent_meanwhile(broker: Broker) -> None:
    sink = sink_of(broker)
    with both_open(source_of(broker), sink) as heard:
        heard.source.close()
        for row in range(0, 500, 5):
            sink.write(output(row, 5))
        sink.flush()
        heard.source.open("")
        heard.until(lambda: len(heard.numbers) >= 500)
    assert heard.numbers == list(range(500))
    assert heard.losses == []


def test_what_mosquitto_loses_when_killed_is_counted(broker: Broker) -> None:
    sink = sink_of(broker)
    with both_open(source_of(broker), sink) as heard:
        sink.write(output(0, 10))
        sink.flush()
        heard.until(lambda: len(heard.numbers) == 10)
        heard.source.close()
        for row in range(10, 510, 10):
            sink.write(output(row, 10))
        sink.flush()  # acknowledged, all of it: and mosquitto has it in memory alone
        broker.kill()
        broker.start()
        heard.source.open(heard.position)
        sink.write(output(510, 10))
        flushed(sink)
        heard.until(lambda: len(heard.numbers) == 20)
    assert heard.numbers == [*range(10), *range(510, 520)]
    assert heard.count(LossKind.MISSING) == 500
    assert "no longer has this client's" in next(loss.says for loss in heard.losses if loss.kind is LossKind.GAP)


def test_killed_brokers_make_a_sink_send_again_in_order(broker: Broker) -> None:
    sink = sink_of(broker)
    with both_open(source_of(broker), sink) as heard:
        for turn in range(4):
            for row in range(turn * 100, turn * 100 + 100, 5):
                sink.write(output(row, 5))
                if row % 100 == 50:
                    broker.kill()
                    broker.start()
                    heard.until(lambda turn=turn: heard.returns > turn)  # type: ignore[misc]
            flushed(sink)
        heard.until(lambda: heard.numbers[-1:] == [399])
    assert len(set(heard.numbers)) == len(heard.numbers)
    assert heard.numbers == sorted(heard.numbers)
    assert len(heard.numbers) + heard.count(LossKind.MISSING) == 400
    assert {loss.kind for loss in heard.losses} <= {LossKind.MISSING, LossKind.GAP, LossKind.REPEATED}


def test_nats_as_an_mqtt_broker_loses_nothing_when_killed(tmp_path: Path) -> None:
    with nats_as_mqtt(tmp_path / "nats") as server:
        sink = sink_of(server, "&version=3.1.1")
        with both_open(source_of(server, "&version=3.1.1"), sink) as heard:
            for turn in range(3):
                for place in range(40):
                    sink.write(output(turn * 200 + place * 5, 5))
                    if place == 20:
                        server.kill()
                        server.start()
                flushed(sink)
            heard.until(lambda: len(heard.numbers) >= 600)
    assert heard.numbers == list(range(600))
    assert heard.count(LossKind.MISSING) == 0


def test_a_broker_of_another_version_is_told(tmp_path: Path) -> None:
    with nats_as_mqtt(tmp_path / "nats") as server, pytest.raises(BecalmError, match="type version=3"):
        source_of(server, "&version=5").open("")


def test_a_broker_that_stands_still_is_away(broker: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    sink = sink_of(broker)
    with both_open(source_of(broker), sink) as heard:
        broker.send(signal.SIGSTOP)
        monkeypatch.setattr(broker_sink, "_STALL_S", 0.2)
        monkeypatch.setattr(mqtt_link, "_ANSWER_S", 0.5)
        try:
            sink.write(output(0, 3))
            with pytest.raises(AwayError, match="acknowledged nothing"):
                sink.flush()
            sink.close()
            with pytest.raises(AwayError, match="does not answer"):
                sink.open(HEAD)
        finally:
            broker.send(signal.SIGCONT)
        monkeypatch.undo()
        flushed(sink)
        heard.until(lambda: heard.numbers == [0, 1, 2])


def test_a_full_queue_makes_the_broker_wait(broker: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt_source, "_QUEUED_BYTES", 2000)
    sink = sink_of(broker)
    with both_open(source_of(broker), sink) as heard:
        for row in range(0, 500, 5):
            sink.write(output(row, 5))
        sink.flush()
        heard.source.close()  # however full the queue is
        heard.source.open("")
        heard.until(lambda: len(heard.numbers) >= 500)
    assert heard.numbers == list(range(500))
    assert heard.losses == []
