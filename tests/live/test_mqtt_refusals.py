"""MQTT where it must say no: whose certificate is trusted, what is no broker, what is no message."""

from __future__ import annotations

import socket
import threading
from contextlib import closing
from pathlib import Path

import pytest

from becalm.errors import BecalmError, InputError, OutputError, UsageError
from becalm.live.address import Address
from becalm.live.brokers import mqtt_link
from becalm.live.brokers.mqtt_link import MqttLink
from becalm.live.brokers.mqtt_session import Session
from becalm.live.brokers.remote import Remote
from becalm.live.protocols import AwayError
from brokered import HEAD, Heard, among_garbage, output
from brokers import DEADLINE_S, certified, mosquitto
from wires import MQTT, carried

source_of, sink_of = MQTT.source, MQTT.sink


@pytest.mark.parametrize(("held", "says"), [("lab", "has 1 lines"), ("a\nb\nc\n", "has 3 lines"), (None, "be read")])
def test_a_password_file_has_two_lines(tmp_path: Path, held: str | None, says: str) -> None:
    file = tmp_path / "secret"
    if held is not None:
        file.write_text(held)
    with pytest.raises(UsageError, match=says):
        source_of(1, f"&password_file={file}").open("")


def test_tls_is_spoken_with_a_certificate_that_is_trusted(tmp_path: Path) -> None:
    papers = certified(tmp_path / "papers")
    with mosquitto(tmp_path / "broker", certificate=papers) as broker:
        ours = f"&ca={papers / 'cert.pem'}"
        assert carried(source_of(broker.port, ours, "localhost"), sink_of(broker.port, ours)).numbers == [0, 1, 2]
        with pytest.raises(InputError, match=r"is not trusted.*ca=FILE"):
            source_of(broker.port, "&tls=1").open("")
        with pytest.raises(AwayError):
            source_of(broker.port).open("")  # in the clear: the broker hangs up


def test_tls_to_one_who_does_not_speak_it_is_told(tmp_path: Path) -> None:
    with mosquitto(tmp_path / "broker") as broker, pytest.raises(BecalmError, match=f"127.0.0.1:{broker.port}"):
        source_of(broker.port, "&tls=1").open("")


@pytest.mark.parametrize("missing", ["ca", "cert"])
def test_certificates_that_are_not_there_are_told(missing: str) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        source_of(1, f"&{missing}=/nowhere/at.all").open("")
    with pytest.raises(UsageError, match="cert=FILE"):
        source_of(1, "&key=/nowhere/at.all").open("")


def test_an_unknown_host_is_a_slip_of_the_pen_only_at_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    with mosquitto(tmp_path / "broker") as broker:
        source = source_of(broker.port, host="localhost")
        source.open("")
        source.close()
        with monkeypatch.context() as patch:
            patch.setattr(socket, "getaddrinfo", unknown)
            with pytest.raises(AwayError):
                source.open("")  # it was there before: the network is broken
            with pytest.raises(InputError, match="no host 'localhost'"):
                source_of(broker.port, host="localhost").open("")


def test_one_who_never_answers_is_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt_link, "_ANSWER_S", 0.2)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        with pytest.raises(AwayError, match="does not answer like an MQTT broker"):
            source_of(int(silent.getsockname()[1])).open("")


def test_a_second_reader_of_the_same_name_is_told() -> None:
    opened = threading.Event()

    def broker(door: socket.socket) -> None:
        wire, _ = door.accept()
        with wire:
            wire.recv(1000)  # CONNECT
            wire.sendall(bytes.fromhex("20 03 00 00 00"))
            asked = wire.recv(1000)  # SUBSCRIBE; its number stands behind two bytes
            wire.sendall(bytes([0x90, 4, asked[2], asked[3], 0, 1]))
            opened.wait(DEADLINE_S)
            wire.sendall(bytes.fromhex("e0 02 8e 00"))  # session taken over: mosquitto 2.0.11 does not say so

    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        door.listen()
        thread = threading.Thread(target=broker, args=(door,))
        thread.start()
        source = source_of(int(door.getsockname()[1]))
        source.open("")
        opened.set()
        with pytest.raises(UsageError, match="client=NAME"):
            Heard(source).until(lambda: False)
        source.close()
        thread.join()


def test_garbage_is_counted_and_rows_go_on(tmp_path: Path) -> None:
    with mosquitto(tmp_path / "broker") as broker:
        remote = Remote.parsed(Address.parsed(f"mqtt://127.0.0.1:{broker.port}/plant/pump"), 1883, 8883)
        heard, sender = Heard(source_of(broker.port)), MqttLink(remote, Session("sender", "5", 0.0, 1))
        with closing(heard.source), closing(sender):
            heard.source.open("")
            sender.connect(reached=False)
            for payload in among_garbage():
                sender.publish("plant/pump", payload)
            heard.until(lambda: len(heard.numbers) == 10)
    heard.assert_garbage_was_counted()


def test_a_large_output_is_sent_in_parts(tmp_path: Path) -> None:
    with mosquitto(tmp_path / "broker") as broker:
        heard = carried(source_of(broker.port), sink_of(broker.port), 50_000, at_once=50_000)
    assert heard.numbers == list(range(50_000))
    assert heard.losses == []


def test_a_row_that_no_message_holds_is_refused(tmp_path: Path) -> None:
    with mosquitto(tmp_path / "broker", more=["max_packet_size 200"]) as broker:
        sink = sink_of(broker.port)
        sink.open(HEAD)
        with pytest.raises(OutputError, match="A row of 2 channels has"):
            sink.write(output(0, 3))
        sink.close()


@pytest.mark.parametrize(
    ("address", "host", "port", "path"),
    [
        ("mqtt://[::1]:7/a/b%20c?tls=1", "::1", 7, "a/b c"),
        ("mqtt://broker/topic", "broker", 1883, "topic"),
        ("mqtt://broker/topic?tls=1", "broker", 8883, "topic"),
        ("mqtt://broker/topic?ca=FILE", "broker", 8883, "topic"),
        ("mqtt:///topic", "127.0.0.1", 1883, "topic"),
    ],
)
def test_hosts_ports_and_topics(address: str, host: str, port: int, path: str) -> None:
    remote = Remote.parsed(Address.parsed(address), 1883, 8883)
    assert (remote.host, remote.port, remote.path) == (host, port, path)
