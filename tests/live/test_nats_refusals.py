"""NATS where it must say no: who may enter, whose certificate is trusted, what is no server."""

from __future__ import annotations

import asyncio
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.brokers import nats_link, nats_pull
from becalm.live.brokers.remote import Remote
from becalm.live.protocols import AwayError, Source
from becalm.live.sinks import broker as broker_sink
from becalm.live.sinks.nats import NatsSink
from brokered import HEAD, flushed, output
from brokers import Broker, certified, nats_server
from pump import made
from wires import NATS, carried, heard_from

WORD = "correct horse"
source_of, sink_of = NATS.source, NATS.sink


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Broker]:
    with nats_server(tmp_path / "nats") as running:
        yield running


def test_a_token_comes_from_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with nats_server(tmp_path / "nats", "--auth", WORD) as server:
        with pytest.raises(InputError, match="BECALM_NATS_TOKEN"):
            source_of(server.port).open("")
        monkeypatch.setenv("BECALM_NATS_TOKEN", WORD)
        made(server)
        assert carried(source_of(server.port), sink_of(server.port)).numbers == [0, 1, 2]


def test_tls_is_spoken_with_a_certificate_that_is_trusted(tmp_path: Path) -> None:
    papers = certified(tmp_path / "papers")
    asked = ["--tls", "--tlscert", str(papers / "cert.pem"), "--tlskey", str(papers / "key.pem")]
    with nats_server(tmp_path / "nats", *asked) as server:
        ours = f"&ca={papers / 'cert.pem'}"
        made(server, ours, "localhost")
        ends = source_of(server.port, ours, "localhost"), sink_of(server.port, ours, "localhost")
        assert carried(*ends).numbers == [0, 1, 2]
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
        with pytest.raises(InputError, match="does not use TLS"):
            source_of(int(door.getsockname()[1]), "&tls=1").open("")
        thread.join()
    assert heard == b""


def test_tls_to_one_who_does_not_speak_it_is_told(server: Broker) -> None:
    with pytest.raises(InputError, match="does not use TLS"):
        source_of(server.port, "&tls=1").open("")


def test_an_unknown_host_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(InputError, match="no host 'broker'"):
        source_of(4222, host="broker").open("")


def read_on(source: Source) -> None:
    while True:
        source.read(0.1)


def test_a_server_that_stands_still_is_away(server: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    made(server)
    source, sink = source_of(server.port), sink_of(server.port)
    source.open("")
    sink.open(HEAD)
    server.send(signal.SIGSTOP)
    monkeypatch.setattr(nats_pull, "_SILENT_S", 0.2)
    monkeypatch.setattr(nats_link, "_ANSWER_S", 2.0)
    monkeypatch.setattr(broker_sink, "_STALL_S", 0.2)
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
    monkeypatch.undo()
    with closing(sink):
        flushed(sink)
    assert heard_from(source, 3).numbers == [0, 1, 2]


@pytest.mark.parametrize("subject", ["", "?subject=plant.*"])
def test_a_sink_needs_one_subject(subject: str) -> None:
    with pytest.raises(UsageError, match=r"add for example subject=clean\.pump"):
        NatsSink(Address.parsed(f"nats://server/PUMP{subject}"))


def test_creds_need_their_library(server: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(UsageError, match="pip install nkeys"):
        source_of(server.port, "&creds=/nowhere").open("")


@pytest.mark.parametrize(("host", "url"), [("[::1]", "nats://[::1]:4222"), ("127.0.0.1", "nats://127.0.0.1:4222")])
def test_a_number_of_ip_version_6_has_brackets(host: str, url: str) -> None:
    urls: list[str] = []

    class Client:
        async def connect(self, url: str, **_: object) -> None:
            urls.append(url)

    link = nats_link.NatsLink(Remote.parsed(Address.parsed(f"nats://{host}/S"), 4222, 4222))
    asyncio.run(link._connect_client(Client(), {}))  # type: ignore[arg-type]
    assert urls == [url]
