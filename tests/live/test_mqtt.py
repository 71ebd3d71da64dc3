"""MQTT through a real mosquitto: rows through it, what it gives twice, and what it loses."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from becalm.errors import BecalmError
from becalm.live.address import Address
from becalm.live.block import LossKind
from becalm.live.brokers import mqtt_link
from becalm.live.protocols import AwayError
from becalm.live.sinks import broker as broker_sink
from becalm.live.sinks.mqtt import MqttSink
from becalm.live.sources import mqtt as mqtt_source
from becalm.live.sources.mqtt import MqttSource
from brokered import HEAD, Heard, flushed, output
from brokers import Broker, mosquitto, nats_as_mqtt


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with mosquitto(tmp_path / "broker") as running:
        yield running


def source_of(broker: Broker, options: str = "", topic: str = "plant/pump") -> MqttSource:
    return MqttSource(Address.parsed(f"mqtt://127.0.0.1:{broker.port}/{topic}?channels=ax,ay{options}"))


def sink_of(broker: Broker, options: str = "gather=0s", topic: str = "plant/pump") -> MqttSink:
    return MqttSink(Address.parsed(f"mqtt://127.0.0.1:{broker.port}/{topic}?{options}"))


@pytest.mark.parametrize("version", ["5", "3.1.1"])
@pytest.mark.parametrize("form", ["arrow", "json"])
def test_rows_go_through(broker: Broker, version: str, form: str) -> None:
    source, sink = (
        source_of(broker, f"&version={version}"),
        sink_of(broker, f"gather=0s&format={form}&version={version}"),
    )
    heard = Heard(source)
    try:
        source.open("")
        sink.open(HEAD)
        for first in range(0, 1000, 10):
            sink.write(output(first, 10))
        sink.flush()
        heard.until(lambda: len(heard.numbers) >= 1000)
    finally:
        source.close()
        sink.close()
    assert heard.numbers == list(range(1000))
    assert heard.losses == []
    assert heard.blocks[0].names == ("ax", "ay")
    assert heard.blocks[0].units == ("m/s^2", "g")
    assert heard.blocks[-1].time_s[-1] == 9.99


def test_what_was_not_kept_comes_again(broker: Broker) -> None:
    first, sink = Heard(source_of(broker)), sink_of(broker)
    first.source.open("")
    sink.open(HEAD)
    for row in range(0, 100, 10):
        sink.write(output(row, 10))
        sink.flush()
        first.until(lambda row=row: len(first.numbers) >= row + 10, commit=False)  # type: ignore[misc]
    kept = first.blocks[3].position
    first.source.committed(kept)
    first.source.close()
    again = Heard(source_of(broker))
    again.source.open(kept)
    again.until(lambda: len(again.numbers) >= 60)
    again.source.close()
    sink.close()
    assert again.numbers == list(range(40, 100))
    assert again.losses == []


def test_what_comes_twice_is_left_out_and_acknowledged(broker: Broker) -> None:
    first, sink = Heard(source_of(broker)), sink_of(broker)
    first.source.open("")
    sink.open(HEAD)
    for row in range(0, 100, 10):
        sink.write(output(row, 10))
    sink.flush()
    first.until(lambda: len(first.numbers) == 100, commit=False)
    first.source.close()
    again = Heard(source_of(broker))  # it was killed after it kept all, before the broker heard of it
    again.source.open(first.position)
    again.until(lambda: again.count(LossKind.REPEATED) == 100, commit=False)
    again.source.close()
    third = Heard(source_of(broker))
    third.source.open(first.position)
    sink.write(output(100, 1))
    sink.flush()
    third.until(lambda: third.numbers == [100])
    third.source.close()
    sink.close()
    assert again.numbers == []
    assert third.losses == []


def test_a_reader_that_was_away_gets_what_was_sent_meanwhile(broker: Broker) -> None:
    heard, sink = Heard(source_of(broker)), sink_of(broker)
    heard.source.open("")
    heard.source.close()
    sink.open(HEAD)
    for row in range(0, 500, 5):
        sink.write(output(row, 5))
    sink.flush()
    sink.close()
    heard.source.open("")
    heard.until(lambda: len(heard.numbers) >= 500)
    heard.source.close()
    assert heard.numbers == list(range(500))
    assert heard.losses == []


def test_what_mosquitto_loses_when_killed_is_counted(broker: Broker) -> None:
    heard, sink = Heard(source_of(broker)), sink_of(broker)
    heard.source.open("")
    sink.open(HEAD)
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
    heard.source.close()
    sink.close()
    assert heard.numbers == [*range(10), *range(510, 520)]
    assert heard.count(LossKind.MISSING) == 500
    assert "has forgotten" in next(loss.says for loss in heard.losses if loss.kind is LossKind.GAP)


def test_killed_brokers_make_a_sink_send_again_in_order(broker: Broker) -> None:
    heard, sink = Heard(source_of(broker)), sink_of(broker)
    heard.source.open("")
    sink.open(HEAD)
    for turn in range(4):
        for row in range(turn * 100, turn * 100 + 100, 5):
            sink.write(output(row, 5))
            if row % 100 == 50:
                broker.kill()
                broker.start()
                heard.until(lambda turn=turn: heard.returns > turn)  # type: ignore[misc]
        flushed(sink)
    heard.until(lambda: heard.numbers[-1:] == [399])
    heard.source.close()
    sink.close()
    assert len(set(heard.numbers)) == len(heard.numbers)
    assert heard.numbers == sorted(heard.numbers)
    assert len(heard.numbers) + heard.count(LossKind.MISSING) == 400
    assert {loss.kind for loss in heard.losses} <= {LossKind.MISSING, LossKind.GAP, LossKind.REPEATED}


def test_nats_as_an_mqtt_broker_loses_nothing_when_killed(tmp_path: Path) -> None:
    with nats_as_mqtt(tmp_path / "nats") as server:
        heard, sink = Heard(source_of(server, "&version=3.1.1")), sink_of(server, "gather=0s&version=3.1.1")
        heard.source.open("")
        sink.open(HEAD)
        for turn in range(3):
            for place in range(40):
                sink.write(output(turn * 200 + place * 5, 5))
                if place == 20:
                    server.kill()
                    server.start()
            flushed(sink)
        heard.until(lambda: len(heard.numbers) >= 600)
        heard.source.close()
        sink.close()
    assert heard.numbers == list(range(600))
    assert heard.count(LossKind.MISSING) == 0


def test_a_broker_of_another_version_is_told(tmp_path: Path) -> None:
    with nats_as_mqtt(tmp_path / "nats") as server, pytest.raises(BecalmError, match="type version=3"):
        source_of(server, "&version=5").open("")


def test_a_broker_that_stands_still_is_away(broker: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(broker_sink, "_STALL_S", 0.2)
    monkeypatch.setattr(mqtt_link, "_ANSWER_S", 0.5)
    sink, heard = sink_of(broker), Heard(source_of(broker))
    heard.source.open("")
    sink.open(HEAD)
    broker.send(signal.SIGSTOP)
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
    heard.source.close()
    sink.close()


def test_a_full_queue_makes_the_broker_wait(broker: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt_source, "_QUEUED_BYTES", 2000)
    heard, sink = Heard(source_of(broker)), sink_of(broker)
    heard.source.open("")
    sink.open(HEAD)
    for row in range(0, 500, 5):
        sink.write(output(row, 5))
    sink.flush()
    heard.source.close()  # however full the queue is
    heard.source.open("")
    heard.until(lambda: len(heard.numbers) >= 500)
    heard.source.close()
    sink.close()
    assert heard.numbers == list(range(500))
    assert heard.losses == []
