"""NATS where it must say no: who may enter, what is no server, which streams are none, what is no address."""

from __future__ import annotations

import signal
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.brokers import nats_link, nats_pull
from becalm.live.protocols import AwayError
from becalm.live.sinks import broker as broker_sink
from becalm.live.sinks.nats import NatsSink
from becalm.live.sources.nats import NatsSource
from brokered import HEAD, Heard, output
from brokers import Broker, certified, nats_server
from pump import made

WORD = "correct horse"


def source_of(port: int, options: str = "", host: str = "127.0.0.1", stream: str = "PUMP") -> NatsSource:
    return NatsSource(Address.parsed(f"nats://{host}:{port}/{stream}?channels=ax,ay{options}"))


def sink_of(port: int, options: str = "", host: str = "127.0.0.1", stream: str = "PUMP") -> NatsSink:
    return NatsSink(Address.parsed(f"nats://{host}:{port}/{stream}?gather=0s&subject=plant.pump{options}"))


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Broker]:
    with nats_server(tmp_path / "nats") as running:
        yield running


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[Broker]:
    with nats_server(tmp_path / "nats", "--user", "lab", "--pass", WORD) as running:
        yield running


@pytest.mark.parametrize("word", ["battery staple", None])
def test_a_wrong_password_is_told(guarded: Broker, word: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    if word is not None:
        monkeypatch.setenv("BECALM_NATS_USER", "lab")
        monkeypatch.setenv("BECALM_NATS_PASSWORD", word)
    with pytest.raises(InputError, match=r"refuses who comes.*BECALM_NATS_PASSWORD") as told:
        source_of(guarded.port).open("")
    assert "staple" not in str(told.value)
    with pytest.raises(InputError, match="refuses who comes"):
        sink_of(guarded.port).open(HEAD)


def test_the_right_password_comes_from_the_environment_or_a_file(
    guarded: Broker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "secret"
    file.write_text(f"lab\n{WORD}\n")
    made(guarded, f"&password_file={file}")
    monkeypatch.setenv("BECALM_NATS_USER", "lab")
    monkeypatch.setenv("BECALM_NATS_PASSWORD", WORD)
    went_through(guarded.port)


def test_a_token_comes_from_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with nats_server(tmp_path / "nats", "--auth", WORD) as server:
        with pytest.raises(InputError, match="BECALM_NATS_TOKEN"):
            source_of(server.port).open("")
        monkeypatch.setenv("BECALM_NATS_TOKEN", WORD)
        made(server)
        went_through(server.port)


def went_through(port: int, options: str = "", host: str = "127.0.0.1") -> None:
    """Send rows through a server."""
    heard, sink = Heard(source_of(port, options, host)), sink_of(port, options, host)
    heard.source.open("")
    sink.open(HEAD)
    sink.write(output(0, 3))
    sink.flush()
    heard.until(lambda: heard.numbers == [0, 1, 2])
    heard.source.close()
    sink.close()


def test_tls_is_spoken_with_a_certificate_that_is_trusted(tmp_path: Path) -> None:
    papers = certified(tmp_path / "papers")
    asked = ["--tls", "--tlscert", str(papers / "cert.pem"), "--tlskey", str(papers / "key.pem")]
    with nats_server(tmp_path / "nats", *asked) as server:
        ours = f"&ca={papers / 'cert.pem'}"
        made(server, ours, "localhost")
        went_through(server.port, ours, "localhost")
        for options in ("&tls=1", ""):  # nats-py speaks TLS wherever the server does
            with pytest.raises(InputError, match=r"is not trusted.*ca=FILE"):
                source_of(server.port, options).open("")


def test_no_secret_goes_to_one_who_does_not_speak_tls(monkeypatch: pytest.MonkeyPatch) -> None:
    heard = b""

    def server(door: socket.socket) -> None:
        nonlocal heard
        wire, _ = door.accept()
        with wire:
            wire.sendall(b'INFO {"server_id":"x","version":"2.10.0","max_payload":1000,"auth_required":true}\r\n')
            heard = wire.recv(1000)

    monkeypatch.setenv("BECALM_NATS_USER", "lab")
    monkeypatch.setenv("BECALM_NATS_PASSWORD", WORD)
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        door.listen()
        thread = threading.Thread(target=server, args=(door,))
        thread.start()
        with pytest.raises(InputError, match="does not speak TLS"):
            source_of(int(door.getsockname()[1]), "&tls=1").open("")
        thread.join()
    assert heard == b""


def test_tls_to_one_who_does_not_speak_it_is_told(server: Broker) -> None:
    with pytest.raises(InputError, match="does not speak TLS"):
        source_of(server.port, "&tls=1").open("")


def test_an_unknown_host_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(InputError, match="no host 'broker'"):
        source_of(4222, host="broker").open("")


def test_nobody_there_is_away() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # and nobody listens
        port = int(taken.getsockname()[1])
        with pytest.raises(AwayError, match="cannot be reached now"):
            source_of(port).open("")
        sink = sink_of(port)
        with pytest.raises(AwayError, match="cannot be reached now"):
            sink.open(HEAD)
        sink.write(output(0, 3))
        with pytest.raises(AwayError):
            sink.flush()


def read_on(source: NatsSource) -> None:
    while True:
        source.read(0.1)


def test_a_server_that_stands_still_is_away(server: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nats_pull, "_SILENT_S", 0.2)
    monkeypatch.setattr(nats_link, "_ANSWER_S", 2.0)
    monkeypatch.setattr(broker_sink, "_STALL_S", 0.2)
    made(server)
    source, sink = source_of(server.port), sink_of(server.port)
    source.open("")
    sink.open(HEAD)
    server.send(signal.SIGSTOP)
    try:
        with pytest.raises(AwayError, match="was silent"):
            read_on(source)
        sink.write(output(0, 3))
        with pytest.raises(AwayError, match="acknowledged nothing"):
            sink.flush()
        source.close()
        sink.close()
        with pytest.raises(AwayError):
            source.open("")
    finally:
        server.send(signal.SIGCONT)
    sink.open(HEAD)
    sink.flush()
    heard = Heard(source)
    source.open("")
    heard.until(lambda: heard.numbers == [0, 1, 2])
    source.close()
    sink.close()


@pytest.mark.parametrize(
    ("address", "says"),
    [
        ("nats:PUMP", "names no host"),
        ("nats://server?subject=a", "names no stream"),
        ("nats://server/plant.pump?subject=a", "'plant.pump'"),
        ("nats://lab:horse@server/PUMP?subject=a", "BECALM_NATS_PASSWORD"),
        ("nats://server/PUMP?subject=a&durable=x", "no option 'durable'"),
    ],
)
def test_addresses_that_cannot_be_are_told(address: str, says: str) -> None:
    for kind in (NatsSource, NatsSink):
        with pytest.raises(UsageError, match=says) as told:
            kind(Address.parsed(address))
        assert "horse" not in str(told.value)


@pytest.mark.parametrize("subject", ["", "?subject=plant.*"])
def test_a_sink_needs_one_subject(subject: str) -> None:
    with pytest.raises(UsageError, match=r"add subject=clean\.pump"):
        NatsSink(Address.parsed(f"nats://server/PUMP{subject}"))


def test_a_position_of_another_source_is_told() -> None:
    with pytest.raises(InputError, match="no position of nats"):
        source_of(1).open('{"blocks": 7}')


def test_creds_need_their_library(server: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(UsageError, match="pip install nkeys"):
        source_of(server.port, "&creds=/nowhere").open("")


def test_a_missing_library_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nats.aio.client", None)
    with pytest.raises(UsageError, match=r"pip install 'becalm\[live\]'"):
        source_of(1).open("")
