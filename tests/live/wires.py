"""Both ends of the rows through a broker, alike for every kind of broker."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

from becalm.live.address import Address
from becalm.live.protocols import Sink, Source
from becalm.live.sinks.mqtt import MqttSink
from becalm.live.sinks.nats import NatsSink
from becalm.live.sources.mqtt import MqttSource
from becalm.live.sources.nats import NatsSource
from brokered import HEAD, Heard, output


@dataclass(frozen=True)
class Wire:
    """A topic or a stream of one kind of broker."""

    kind: str
    path: str
    to: str  # what addresses of its sinks need
    source_at: Callable[[Address], Source]
    sink_at: Callable[[Address], Sink]

    def source(self, port: int, options: str = "", host: str = "127.0.0.1") -> Source:
        """Return a source of two channels."""
        return self.source_at(Address.parsed(f"{self.kind}://{host}:{port}/{self.path}?channels=ax,ay{options}"))

    def sink(self, port: int, options: str = "", host: str = "127.0.0.1") -> Sink:
        """Return a sink that sends each output at once."""
        return self.sink_at(Address.parsed(f"{self.kind}://{host}:{port}/{self.path}?gather=0s{self.to}{options}"))

    def variable(self, what: str) -> str:
        """Return which variable of the environment holds a USER or a PASSWORD."""
        return f"BECALM_{self.kind.upper()}_{what}"


MQTT = Wire("mqtt", "plant/pump", "", MqttSource, MqttSink)
NATS = Wire("nats", "PUMP", "&subject=plant.pump", NatsSource, NatsSink)


@contextmanager
def both_open(source: Source, sink: Sink) -> Iterator[Heard]:
    """Open both ends, and close them at the end."""
    with closing(source), closing(sink):
        source.open("")
        sink.open(HEAD)
        yield Heard(source)


def carried(source: Source, sink: Sink, rows: int = 3, at_once: int = 3) -> Heard:
    """Send rows from end to end, and return what was heard."""
    with both_open(source, sink) as heard:
        for first in range(0, rows, at_once):
            sink.write(output(first, at_once))
        sink.flush()
        heard.until(lambda: len(heard.numbers) >= rows)
    return heard


def heard_from(source: Source, rows: int, position: str = "", *, commit: bool = True) -> Heard:
    """Return what a source tells after a position, once so many rows came."""
    heard = Heard(source)
    with closing(source):
        source.open(position)
        heard.until(lambda: len(heard.numbers) >= rows, commit=commit)
    return heard
