"""Where both brokers must say no alike: who may enter, who is not there, what is no address."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.brokers.remote import Remote
from becalm.live.protocols import AwayError
from brokered import HEAD, output
from brokers import Broker, mosquitto, nats_server
from pump import made
from wires import MQTT, NATS, Wire, carried

WORD = "correct horse"


@dataclass(frozen=True)
class Guarded:
    """A broker that lets in who knows the word."""

    wire: Wire
    broker: Broker
    options: str = ""


@pytest.fixture(params=["mqtt 5", "mqtt 3.1.1", "nats"])
def guarded(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Guarded]:
    kind, _, version = request.param.partition(" ")
    if kind == "nats":
        with nats_server(tmp_path / "broker", "--user", "lab", "--pass", WORD) as running:
            yield Guarded(NATS, running)
    else:
        with mosquitto(tmp_path / "broker", passwords={"lab": WORD}) as running:
            yield Guarded(MQTT, running, f"&version={version}")


@pytest.mark.parametrize("word", ["battery staple", None])
def test_a_wrong_password_is_told(guarded: Guarded, word: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    wire, port = guarded.wire, guarded.broker.port
    if word is not None:
        monkeypatch.setenv(wire.variable("USER"), "lab")
        monkeypatch.setenv(wire.variable("PASSWORD"), word)
    with pytest.raises(InputError, match=rf"refuses the login.*{wire.variable('PASSWORD')}") as told:
        wire.source(port, guarded.options).open("")
    assert "staple" not in str(told.value)
    with pytest.raises(InputError, match="refuses the login"):
        wire.sink(port, guarded.options).open(HEAD)


def test_the_right_password_comes_from_the_environment_or_a_file(
    guarded: Guarded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire, port = guarded.wire, guarded.broker.port
    file = tmp_path / "secret"
    file.write_text(f"lab\n{WORD}\n")
    by_file = f"{guarded.options}&password_file={file}"
    if wire is NATS:
        made(guarded.broker, by_file)
    assert carried(wire.source(port, by_file), wire.sink(port, by_file)).numbers == [0, 1, 2]
    monkeypatch.setenv(wire.variable("USER"), "lab")
    monkeypatch.setenv(wire.variable("PASSWORD"), WORD)
    assert carried(wire.source(port, guarded.options), wire.sink(port, guarded.options)).numbers == [0, 1, 2]
    remote = Remote.parsed(Address.parsed(f"{wire.kind}://broker/topic"), 1, 2)
    assert WORD not in repr(remote.login()) + repr(remote)


@pytest.mark.parametrize("wire", [MQTT, NATS], ids=["mqtt", "nats"])
def test_nobody_there_is_away(wire: Wire) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # and nobody listens
        port = int(taken.getsockname()[1])
        with pytest.raises(AwayError, match="cannot be reached now"):
            wire.source(port).open("")
        sink = wire.sink(port)
        with pytest.raises(AwayError, match="cannot be reached now"):
            sink.open(HEAD)
        sink.write(output(0, 3))
        with pytest.raises(AwayError):
            sink.flush()


@pytest.mark.parametrize(
    ("wire", "address", "says"),
    [
        (MQTT, "mqtt:topic", "names no host"),
        (MQTT, "mqtt://broker", "names no topic"),
        (MQTT, "mqtt://broker/plant/+/x", "many topics"),
        (MQTT, "mqtt://broker/plant/#", "many topics"),
        (MQTT, "mqtt://broker:99999/topic", "no port from"),
        (MQTT, "mqtt://lab:horse@broker/topic", "BECALM_MQTT_PASSWORD"),
        (MQTT, "mqtt://broker/topic?qos=2", "no option 'qos'"),
        (MQTT, "mqtt://broker/topic?version=4", "not one of 5, 3.1.1"),
        (MQTT, "mqtt://broker/topic?tls=maybe", "not one of 0, 1"),
        (NATS, "nats:PUMP", "names no host"),
        (NATS, "nats://server?subject=a", "names no stream"),
        (NATS, "nats://server/plant.pump?subject=a", "'plant.pump'"),
        (NATS, "nats://lab:horse@server/PUMP?subject=a", "BECALM_NATS_PASSWORD"),
        (NATS, "nats://server/PUMP?subject=a&durable=x", "no option 'durable'"),
    ],
)
def test_addresses_that_cannot_be_are_told(wire: Wire, address: str, says: str) -> None:
    for end_at in (wire.source_at, wire.sink_at):
        with pytest.raises(UsageError, match=says) as told:
            end_at(Address.parsed(address))
        assert "horse" not in str(told.value)


@pytest.mark.parametrize(
    ("wire", "position"), [(MQTT, '{"row": 7}'), (MQTT, "what?"), (NATS, '{"blocks": 7}'), (NATS, "what?")]
)
def test_a_position_of_another_source_is_told(wire: Wire, position: str) -> None:
    with pytest.raises(InputError, match=f"not a position of {wire.kind}"):
        wire.source(1).open(position)


@pytest.mark.parametrize(("wire", "library"), [(MQTT, "paho.mqtt.client"), (NATS, "nats.aio.client")])
def test_a_missing_library_is_told(wire: Wire, library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(UsageError, match=r"pip install 'becalm\[live\]'"):
        wire.source(1).open("")
